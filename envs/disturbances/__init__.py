"""Pushes and loads."""
