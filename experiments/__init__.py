"""surefoot.experiments."""
