"""Verification: dependence of each metric on grids, tolerances and contact parameters, see ASME V&V 20."""
