"""Independent random streams of one seed: effects do not change each other's draws."""

import numpy as np

# Another order changes the captures of a seed.
_NAMES = (
    *("jitter", "scatterers", "noise", "drift", "channels", "roughness"),
    *("channel_gains", "leakage", "walk", "plane_phase", "dc", "ripple"),
    *("angles", "bulge", "lines", "patches", "vibration", "encoder"),
)


def stream(seed: int, name: str, *part: int) -> np.random.Generator:
    """Return the generator of one stream, or of one part of it, such as a plane."""
    return np.random.default_rng([seed, _NAMES.index(name), *part])
