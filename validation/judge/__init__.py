"""Measured minus planned: metrics, tolerance profiles, verdicts."""
