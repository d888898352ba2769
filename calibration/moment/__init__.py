"""The moment filter: scales and offsets from what forces and moments must add up to (docs/estimator.md)."""
