"""The senses of one robot: the instruments under its feet, its telemetry, and the view of both."""
