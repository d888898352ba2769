"""A robot that walks live in the browser, with its feet's readings, and controls for what happens to it."""
