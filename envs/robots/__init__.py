"""Descriptions of robots: the NAO-class biped, and those that others made."""
