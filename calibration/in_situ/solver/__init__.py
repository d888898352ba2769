"""The problem of a fit: sets compressed to few rows, coloured noise, laws and the least squares of all."""
