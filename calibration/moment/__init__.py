"""The moment filter: gains and offsets from what forces and moments must add up to (docs/estimator.md)."""
