"""What real instruments would show of a walk: force plate, foot force/torque sensor, IMU."""
