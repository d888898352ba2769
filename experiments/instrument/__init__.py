"""The instrument as a recording shows it: what is wrong with it, and a preset that behaves like it."""
