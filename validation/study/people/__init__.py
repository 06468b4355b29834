"""Recorded people beside plans and simulated bodies: force plates and markers, compared over the stride."""
