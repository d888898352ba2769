"""surefoot.wrappers."""
