"""Gaits, runs or sweeps side by side."""
