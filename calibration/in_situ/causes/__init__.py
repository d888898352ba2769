"""Causes why sets contradict each other: those that are tried, and their ranking."""
