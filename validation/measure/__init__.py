"""Measurements from a record, independent of the plan."""
