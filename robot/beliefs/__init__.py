"""One robot's beliefs of its own motion and of its contacts, and how wrong it is about itself."""
