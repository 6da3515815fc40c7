"""Matched-filter volumes of whole captures."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Array, Floats, Progress
from geraf2.geometry.transforms import triple
from geraf2.ops import matched_filter
from geraf2.scene import Capture, Grid, Pose, Waveform

# Voxels that are imaged at once, 256 a side: a complex image and its magnitudes take 0.25 GiB.
_MAX_SLAB_VOXELS = 256**3


def image_volume(
    capture: Capture,
    grid: Grid,
    *,
    poses: Sequence[int] | None = None,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> Array:
    """Sum over poses of the magnitude of each pose's full-aperture image, grid.shape.

    V(x) = sum_p |P_p(x)|, P_p(x) = 1/N_p sum_i sum_t s_i(t) exp(+j 2 pi (nu + k t) d_i(x) / c).
    Magnitudes are added, since a smooth surface is not coherent over the turntable's angles.

    Parameters
    ----------
    capture
        The scan.
    grid
        Voxels to image [m].
    poses
        Indices of the poses to use; all when None.
    num_threads
        When None, torch's number if torch is loaded, else all cores.
    progress
        Called with the fraction done.

    Returns
    -------
    ndarray of float32, or of float64 where the samples are complex128
        Array of grid.shape. matched_filter chooses the method, see
        :func:`geraf2.ops.explain_method`.

    Raises
    ------
    ValueError
        If shapes do not agree.

    Examples
    --------
    >>> grid = geraf2.Grid.cube((0.0, 0.0, 0.0), half_side_m=0.04, n_per_side=21)
    >>> geraf2.image_volume(geraf2.examples.small_capture()[0], grid, poses=[0]).shape
    (21, 21, 21)
    """
    chosen = range(len(capture.poses)) if poses is None else poses
    is_double = len(chosen) > 0 and capture.poses[chosen[0]].signal.dtype == np.complex128
    volume = np.zeros(grid.shape, dtype=np.float64 if is_double else np.float32)
    parts = list(slabs_of(grid))
    for number, index in enumerate(chosen):
        pose = capture.poses[index]  # read the signal once for all slabs
        for k, (region, part) in enumerate(parts):
            report = _part(progress, number * len(parts) + k, len(chosen) * len(parts))
            volume[region] += np.abs(
                pose_image(pose, part, capture.waveform, num_threads=num_threads, progress=report)
            )
    return volume


def slabs_of(grid: Grid) -> Iterator[tuple[tuple[slice, ...], Grid]]:
    """Yield the index of each slab of a grid along its longest axis, and its voxels."""
    axis = max(range(3), key=lambda a: grid.shape[a])
    n_all = grid.shape[axis]
    n_layers = max(1, _MAX_SLAB_VOXELS * n_all // grid.n_voxels)
    for first in range(0, n_all, n_layers):
        index = [slice(0, n) for n in grid.shape]
        index[axis] = slice(first, min(first + n_layers, n_all))
        nx, ny, nz = (s.stop - s.start for s in index)
        corner = np.array([s.start for s in index])
        origin = triple(np.asarray(grid.origin_m) + grid.spacing_m * corner)
        yield tuple(index), replace(grid, origin_m=origin, shape=(nx, ny, nz))


def plane_images(
    capture: Capture,
    grid: Grid,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> Iterator[NDArray[np.complex64]]:
    """Complex full-aperture image of each pose, grid.shape; arguments of :func:`image_volume`."""
    for number, pose in enumerate(capture.poses):
        part = _part(progress, number, len(capture.poses))
        yield pose_image(pose, grid, capture.waveform, num_threads=num_threads, progress=part)


def pose_image(
    pose: Pose,
    points: Grid | Floats,
    waveform: Waveform,
    *,
    signal: NDArray[np.complex64] | None = None,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> NDArray[np.complex64]:
    """Matched-filter image of a pose's signal, or of another signal of its antennas."""
    signal = pose.signal if signal is None else signal
    tx, rx = pose.tx_positions, pose.rx_positions
    return matched_filter(
        signal, tx, rx, points, waveform, num_threads=num_threads, progress=progress
    )


def _part(progress: Progress | None, number: int, n_parts: int) -> Progress | None:
    """Progress of one of n parts, as a fraction of the whole."""
    if progress is None:
        return None
    return lambda fraction: progress((number + fraction) / n_parts)
