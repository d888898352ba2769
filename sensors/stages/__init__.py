"""One law of error a file; a device is a chain of them."""
