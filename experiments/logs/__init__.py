"""Logs of simulated and real robots (docs/log-format.md)."""
