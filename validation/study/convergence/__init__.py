"""Verification: dependence of each metric on grids, tolerances and contact parameters.

The terms are those of ASME V&V 10 and V&V 20: solution verification, observed order of accuracy, numerical
uncertainty.
"""
