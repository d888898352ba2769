"""A Unitree G1 that leans towards the edge of its support under a load that it does not know."""
