"""surefoot.sensors."""
