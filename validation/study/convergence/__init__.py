"""Verification of the numbers: how far each metric depends on grids, tolerances and contact parameters.

The words are those of ASME V&V 10 and V&V 20: solution verification, observed order of accuracy, numerical
uncertainty.
"""
