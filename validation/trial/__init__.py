"""From run parameters to a simulation record in memory."""
