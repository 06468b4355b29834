"""Search for the free parameters of a gait that a body can walk."""
