"""Broken channels, and when they break."""
