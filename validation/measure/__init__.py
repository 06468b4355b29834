"""Measurements from a record. Nothing here imports the plan."""
