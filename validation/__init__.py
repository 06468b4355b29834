"""The trial: simulation, measurement, comparison, reports. Sole owner of MuJoCo data."""
