"""Independent random streams of one seed: effects do not change each other's draws."""

import numpy as np

# Another number of a stream changes the captures of a seed.
JITTER, SCATTERERS, NOISE, DRIFT, CHANNELS, ROUGHNESS = range(6)
CHANNEL_GAINS, LEAKAGE, WALK, PLANE_PHASE, DC, RIPPLE, ANGLES, BULGE, LINES, PATCHES = range(6, 16)


def stream(seed: int, number: int, *part: int) -> np.random.Generator:
    """Return the generator of one stream, or of one part of it, such as a plane."""
    return np.random.default_rng([seed, number, *part])
