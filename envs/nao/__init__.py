"""The NAO-class biped and its tasks."""
