"""Two gaits side by side."""
