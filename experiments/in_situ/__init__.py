"""In-situ calibration of F/T sensors: logs of robots, the simulated rig, studies and pages."""
