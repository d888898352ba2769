"""The instrument as a recording shows it: its flaws, and a preset that behaves like it."""
