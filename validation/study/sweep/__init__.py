"""Sweeps: many runs from one definition, stored durably, and shown on one page."""
