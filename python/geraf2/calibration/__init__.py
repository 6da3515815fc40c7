"""Estimation of a capture's errors: sign of the phase, delay, walls, channels, positions."""
