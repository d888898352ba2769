"""How data frames are annotated; private to :mod:`surefoot.experiments`."""

from typing import Any

__all__ = ["Column", "Frame"]

Frame = Any
"""A pandas data frame: type checkers do not follow what indexing one gives."""

Column = Any
"""A pandas series, likewise."""
