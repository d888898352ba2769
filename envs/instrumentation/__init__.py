"""Any MuJoCo model becomes a robot with measured feet."""
