"""Sweeps: many runs from one definition, kept whatever happens, and told on one page."""
