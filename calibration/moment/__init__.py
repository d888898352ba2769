"""The moment filter: forces predict a robot's momentum, and what it knows of its motion measures it."""
