"""A leg on a stand, with masses to hang on it."""
