"""How long planning, whole-body motion, control and simulation take: ``python -m benchmarks --help``."""
