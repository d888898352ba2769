"""The treatment of readings before any method learns from them: checks, averages, alignment in time."""
