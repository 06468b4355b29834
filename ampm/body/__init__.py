"""Model of the body for planner and controller, and its whole-body motion."""
