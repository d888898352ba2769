"""Standing exercises for any flat-footed robot."""
