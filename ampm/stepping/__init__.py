"""The stabiliser that steps: where and when to step, and the walk that has left its plan."""
