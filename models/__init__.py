"""Bodies for the simulator, built from published tables."""
