"""What a capture does not know of itself: sign of the phase, delay, walls, channels, positions."""
