"""Any antennas as blocks that look along -x, or as one sub-aperture; bins for its image."""

import numpy as np

from geraf2.ops.physical_optics import AntennaBlocks
from geraf2.ops.subaperture import CosineAxis, SubapertureBins, Subapertures


def scattered(rng, n, x_m, apart_m):
    """Transmitters over 14 x 24 cm of the plane x = `x_m`, each receiver somewhere beside."""
    y, z = rng.uniform(-0.07, 0.07, n), rng.uniform(-0.12, 0.12, n)
    tx = np.stack([np.full(n, x_m), y, z], axis=1)
    return tx, tx + rng.uniform(-apart_m, apart_m, tx.shape)


def blocks_of(tx, rx=None, *, offsets=None, **changes):
    """Antennas in one block unless `offsets` say otherwise; a receiver is its transmitter."""
    tx = np.atleast_2d(tx)
    parts = {
        "tx": tx,
        "rx": tx if rx is None else np.atleast_2d(rx),
        "offsets": np.array([0, len(tx)]) if offsets is None else np.array(offsets),
        "boresight": np.array([-1.0, 0.0, 0.0]),
    }
    return AntennaBlocks(**parts | changes)


def members_of(positions, **changes):
    """A sub-aperture of all antennas, which lie at `positions` in it, (n, 2) [m]."""
    n = len(positions)
    parts = {
        "offsets": np.array([0, n]),
        "antennas": np.arange(n),
        "weights": np.full(n, 1.0 / n),
        "positions": positions,
        "focus": np.zeros((1, 3)),
        "focus_range_m": np.full(1, 0.4),
        "lattice": None,
    }
    return Subapertures(**parts | changes)


def bins_of(horizontal=(5, 0.06), vertical=None, *, wraps=False, n_ranges=4):
    """Axes of (count, pitch); the vertical one is as the horizontal, but never wraps."""
    return SubapertureBins(
        horizontal=CosineAxis.symmetric(*horizontal, wraps=wraps),
        vertical=CosineAxis.symmetric(*(vertical or horizontal), wraps=False),
        first_range_m=0.37,
        range_pitch_m=0.02,
        n_ranges=n_ranges,
    )
