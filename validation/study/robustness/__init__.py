"""What a gait survives: pushes by direction, phase and height, and all other disturbances."""
