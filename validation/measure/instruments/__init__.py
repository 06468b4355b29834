"""Models of real instruments that observe a walk: force plate, foot force/torque sensor, IMU."""
