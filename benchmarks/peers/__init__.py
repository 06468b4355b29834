"""The same work by other libraries: ``python -m benchmarks peers --help``."""
