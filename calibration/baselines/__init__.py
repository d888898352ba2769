"""Methods to compare with: tare alone, and nothing at all."""
