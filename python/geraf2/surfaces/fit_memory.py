"""Memory of a fit, estimated without the modules that the fit imports."""

# Property of the preset fast on one machine; within 5 % for 1 to 4.3 million voxels
# (`bench/python/memory.py`).
_FIXED_BYTES, _BYTES_PER_VOXEL = 200e6, 155.0


def fit_bytes(n_voxels: float) -> float:
    """Peak memory of a process that fits a grid of n_voxels [bytes]."""
    return _FIXED_BYTES + _BYTES_PER_VOXEL * n_voxels
