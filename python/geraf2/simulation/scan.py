"""Antenna planes around a turntable, and their cutting into blocks."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from geraf2._types import Floats, Ints
from geraf2.io.scan_file import ScanFile
from geraf2.ops.physical_optics import AntennaBlocks
from geraf2.scene.plan import rows_columns
from geraf2.simulation.spec import RingSpec, ScanSpec


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanPlane:
    """Antennas of one pose; on a raster, the vertical index runs fastest."""

    tx: Floats
    """(n_antennas, 3) [m]."""
    rx: Floats
    """(n_antennas, 3) [m]."""
    axes: Floats
    """Rows: viewing direction, horizontal, vertical, (3, 3)."""
    angle_deg: float
    """Angle of the plane's centre from x to y [degrees]."""
    shape: tuple[int, int] | None
    """Antennas horizontally and vertically; None without a raster."""
    spacing_m: float
    """Their distance [m]."""
    name: str = ""
    """Its name; by its number and angle when empty."""


def scan_planes(scan: ScanSpec) -> list[ScanPlane]:
    """Planes of a scan, in order.

    scan: the scan; as many antennas as fit into the aperture, centred in it.
    """
    swept = [] if scan.sweeps is None else list(_read_planes(scan.sweeps))
    rings = [plane for ring in scan.all_rings for plane in _ring(ring, scan.tx_rx_distance_m)]
    return swept + rings


def _read_planes(scan: ScanFile) -> Iterator[ScanPlane]:
    """Planes of a scan file."""
    for plane in scan.planes:
        tx, rx = scan.antennas(plane)
        axes, spacing = np.array(plane.axes), scan.spacing_m
        yield ScanPlane(
            tx=tx, rx=rx, axes=axes, angle_deg=plane.angle_deg, shape=None, spacing_m=spacing
        )


def _ring(ring: RingSpec, tx_rx_distance_m: float) -> Iterator[ScanPlane]:
    """Planes of a ring that has all its values."""
    assert ring.standoff_m is not None
    assert ring.aperture_m is not None
    assert ring.spacing_m is not None
    n_rows, n_columns = rows_columns(ring.aperture_m, ring.spacing_m)
    shape = n_columns, n_rows
    offsets = [(np.arange(n) - 0.5 * (n - 1)) * ring.spacing_m for n in shape]
    closed = np.isclose(ring.arc_deg, 360.0) or ring.n_poses == 1
    step_deg = ring.arc_deg / (ring.n_poses if closed else ring.n_poses - 1)
    h, v = (grid.ravel() for grid in np.meshgrid(*offsets, indexing="ij"))
    for pose in range(ring.n_poses):
        angle_deg = ring.start_angle_deg + pose * step_deg
        outward, axes = plane_frame(angle_deg, ring.elevation_deg, ring.tilt_deg)
        horizontal, vertical = axes[1:]
        centers = (
            ring.standoff_m * outward
            + ring.height_m * np.array([0.0, 0.0, 1.0])
            + h[:, None] * horizontal
            + v[:, None] * vertical
        )
        apart = 0.5 * tx_rx_distance_m * horizontal
        yield ScanPlane(
            tx=centers + apart,
            rx=centers - apart,
            axes=axes,
            angle_deg=float(angle_deg),
            shape=shape,
            spacing_m=ring.spacing_m,
        )


def plane_frame(angle_deg: float, elevation_deg: float, tilt_deg: float) -> tuple[Floats, Floats]:
    """Direction from the origin to a plane's centre, (3,), and the plane's axes, (3, 3).

    The axes are turned about the horizontal one by the tilt, which raises the viewing direction
    from the one towards the origin.
    """
    angle, elevation, tilt = np.deg2rad((angle_deg, elevation_deg, tilt_deg))
    flat, up = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([0.0, 0.0, 1.0])
    horizontal = np.array([-np.sin(angle), np.cos(angle), 0.0])
    if elevation == 0.0 and tilt == 0.0:  # exactly so, with no -0.0 and no rounding
        return flat, np.stack([-flat, horizontal, up])
    outward = np.cos(elevation) * flat + np.sin(elevation) * up
    back = np.cos(elevation - tilt) * flat + np.sin(elevation - tilt) * up
    vertical = np.cos(elevation - tilt) * up - np.sin(elevation - tilt) * flat
    return outward, np.stack([-back, horizontal, vertical])


def antenna_blocks(plane: ScanPlane, block_m: float) -> tuple[Ints, Ints]:
    """Order of the antennas in which blocks are contiguous, and the blocks' offsets.

    plane: the antennas.
    block_m: largest side of a block [m].
    """
    if plane.shape is None:
        return _cells(plane, block_m)
    shape, per_block = plane.shape, max(1, int(block_m / plane.spacing_m))
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    parts = [
        part.ravel()
        for column in np.array_split(index, -(-shape[0] // per_block), axis=0)
        for part in np.array_split(column, -(-shape[1] // per_block), axis=1)
    ]
    offsets = np.cumsum([0] + [part.size for part in parts])
    return np.concatenate(parts), offsets.astype(np.int64)


def _cells(plane: ScanPlane, block_m: float) -> tuple[Ints, Ints]:
    """Blocks of antennas without a raster: by the cell of the plane that holds the phase centre."""
    local = 0.5 * (plane.tx + plane.rx) @ plane.axes[1:].T
    cells = np.floor((local - local.min(axis=0)) / block_m + 1e-9).astype(np.int64)
    label = cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]
    order = np.argsort(label, kind="stable")
    starts = np.flatnonzero(np.diff(label[order])) + 1
    return order, np.concatenate([[0], starts, [len(order)]]).astype(np.int64)


def block_centers(antennas: AntennaBlocks) -> Floats:
    """Middle of the antennas of each block, (n_blocks, 3) [m]."""
    centers = 0.5 * (antennas.tx + antennas.rx)
    ends = zip(antennas.offsets[:-1], antennas.offsets[1:], strict=True)
    return np.array([centers[start:end].mean(axis=0) for start, end in ends])
