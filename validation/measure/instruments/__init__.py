"""Models of real instruments that measure a walk: force plate, foot force/torque sensor, IMU."""
