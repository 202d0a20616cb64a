"""A virtual force plate under a robot."""
