"""The study of the in-situ paper, on a simulated rig: methods, truth, claims and page."""
