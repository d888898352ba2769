"""MJCF models of the robots."""
