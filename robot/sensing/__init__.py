"""What one robot senses: the instruments under its feet, its telemetry, and what is seen of both."""
