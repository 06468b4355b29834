"""Sweeps: many runs from one definition, kept whatever happens, and shown on one page."""
