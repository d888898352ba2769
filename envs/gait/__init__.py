"""Walking patterns: footsteps, centre of mass, joints."""
