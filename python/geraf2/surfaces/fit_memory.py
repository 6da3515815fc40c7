"""Memory of a fit, known without loading it."""

# Peaks of `geraf2 reconstruct --preset fast`: 341, 582 and 817 MiB with grids of 1.0, 2.9 and 4.3
# million voxels, within 5 % of this (`bench/python/memory.py`).
_FIXED_BYTES, _BYTES_PER_VOXEL = 200e6, 155.0


def fit_bytes(n_voxels: float) -> float:
    """Peak memory of a process that fits a grid of so many voxels."""
    return _FIXED_BYTES + _BYTES_PER_VOXEL * n_voxels
