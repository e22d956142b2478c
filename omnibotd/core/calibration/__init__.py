"""Measuring the robot itself: the lens, the optical axis, the wheels."""
