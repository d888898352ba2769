"""The moment filter: forces predict a robot's momentum, and its beliefs about its motion measure it."""
