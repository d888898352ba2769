"""All calibrators on the same walks, in many scenarios."""
