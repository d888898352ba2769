"""surefoot.controllers."""
