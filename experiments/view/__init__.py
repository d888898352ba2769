"""A robot that walks live in the browser, with what its feet read, and what can be done to it meanwhile."""
