"""Network and world in 3D."""
