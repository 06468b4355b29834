"""Verification of the numbers themselves: how far each depends on grids, tolerances and contact parameters.

The words are those of ASME V&V 10 and V&V 20: solution verification, observed order of accuracy, numerical
uncertainty.
"""
