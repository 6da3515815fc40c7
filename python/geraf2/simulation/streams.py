"""Independent random streams of one seed: what one effect draws, no other effect changes."""

import numpy as np

# A stream keeps its number for good: another number is another capture of the same seed.
JITTER, SCATTERERS, NOISE, DRIFT, CHANNELS, ROUGHNESS = range(6)
CHANNEL_GAINS, LEAKAGE, WALK, PLANE_PHASE, DC, RIPPLE, ANGLES, BULGE, LINES, PATCHES = range(6, 16)


def stream(seed: int, number: int, *part: int) -> np.random.Generator:
    """Start the generator of one stream, of one part of it, such as a plane."""
    return np.random.default_rng([seed, number, *part])
