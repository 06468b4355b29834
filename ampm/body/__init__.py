"""The body as planner and controller know it, and its whole-body motion."""
