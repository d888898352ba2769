"""What every method does to readings before it learns from them: checks, averages, alignment in time."""
