"""Policies that act on the centre of pressure: training, evaluation, and those that come with the package."""
