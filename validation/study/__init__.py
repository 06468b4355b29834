"""Studies of many trials: sweeps, convergence, comparison."""
