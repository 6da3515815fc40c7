"""Matched-filter volumes of whole captures."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from geraf2._types import Floats, Progress
from geraf2.imaging.slabs import Slabs
from geraf2.ops import matched_filter
from geraf2.scene import Capture, Grid, Pose, Waveform


def image_volume(
    capture: Capture,
    grid: Grid,
    *,
    poses: Sequence[int] | None = None,
    slabs: Slabs | None = None,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> NDArray[np.float32]:
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
    slabs
        Parts of the grid that are imaged in sequence, which limits the memory; the whole grid at
        once when None. The ends of slabs determine the nodes of the interpolation, so results for
        other slabs differ within the method's rtol.
    num_threads
        When None, torch's number if torch is loaded, else all cores.
    progress
        Called with the fraction done.

    Returns
    -------
    ndarray of float32
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
    volume = np.zeros(grid.shape, dtype=np.float32)
    chosen = range(len(capture.poses)) if poses is None else poses
    parts = [((), grid)] if slabs is None else list(slabs)
    for number, index in enumerate(chosen):
        pose = capture.poses[index]  # read the signal once for all slabs
        for k, (region, part) in enumerate(parts):
            report = _part(progress, number * len(parts) + k, len(chosen) * len(parts))
            volume[region] += np.abs(
                pose_image(pose, part, capture.waveform, num_threads=num_threads, progress=report)
            )
    return volume


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
