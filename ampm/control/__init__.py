"""Whole-body torque control along a reference."""
