"""Antenna planes around a turntable, and their cutting into blocks."""

from dataclasses import dataclass

import numpy as np

from geraf2._types import Floats, Ints
from geraf2.ops.physical_optics import AntennaBlocks
from geraf2.simulation.spec import ScanSpec


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanPlane:
    """Antennas of one pose on a raster, the vertical index running fastest."""

    tx: Floats
    """(n_antennas, 3) [m]."""
    rx: Floats
    """(n_antennas, 3) [m]."""
    axes: Floats
    """Rows: looking direction, horizontal, vertical, (3, 3)."""
    angle_deg: float
    """Angle of the plane's centre from x to y [degrees]."""
    shape: tuple[int, int]
    """Antennas horizontally and vertically."""


def scan_planes(scan: ScanSpec) -> list[ScanPlane]:
    """Planes of a scan, in order.

    scan: the scan; as many antennas as fit into the aperture, centred in it.
    """
    # 1e-9: an aperture that is a whole number of spacings keeps its last antenna.
    counts = [int(np.floor(side / scan.spacing_m + 1e-9)) + 1 for side in scan.aperture_m]
    offsets = [(np.arange(n) - 0.5 * (n - 1)) * scan.spacing_m for n in counts]
    closed = np.isclose(scan.arc_deg, 360.0) or scan.n_poses == 1
    step_deg = scan.arc_deg / (scan.n_poses if closed else scan.n_poses - 1)
    planes = []
    for pose in range(scan.n_poses):
        angle_deg = scan.start_angle_deg + pose * step_deg
        angle = np.deg2rad(angle_deg)
        outward = np.array([np.cos(angle), np.sin(angle), 0.0])
        horizontal = np.array([-np.sin(angle), np.cos(angle), 0.0])
        vertical = np.array([0.0, 0.0, 1.0])
        h, v = (grid.ravel() for grid in np.meshgrid(*offsets, indexing="ij"))
        centers = (
            scan.standoff_m * outward
            + scan.height_m * vertical
            + h[:, None] * horizontal
            + v[:, None] * vertical
        )
        apart = 0.5 * scan.tx_rx_distance_m * horizontal
        planes.append(
            ScanPlane(
                tx=centers + apart,
                rx=centers - apart,
                axes=np.stack([-outward, horizontal, vertical]),
                angle_deg=float(angle_deg),
                shape=(counts[0], counts[1]),
            )
        )
    return planes


def antenna_blocks(shape: tuple[int, int], spacing_m: float, block_m: float) -> tuple[Ints, Ints]:
    """Order of the antennas in which blocks are contiguous, and the blocks' offsets.

    shape: antennas horizontally and vertically.
    spacing_m: their distance [m].
    block_m: largest side of a block [m].
    """
    per_block = max(1, int(block_m / spacing_m))
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    parts = [
        part.ravel()
        for column in np.array_split(index, -(-shape[0] // per_block), axis=0)
        for part in np.array_split(column, -(-shape[1] // per_block), axis=1)
    ]
    offsets = np.cumsum([0] + [part.size for part in parts])
    return np.concatenate(parts), offsets.astype(np.int64)


def block_centers(antennas: AntennaBlocks) -> Floats:
    """Middle of the antennas of each block, (n_blocks, 3) [m]."""
    centers = 0.5 * (antennas.tx + antennas.rx)
    ends = zip(antennas.offsets[:-1], antennas.offsets[1:], strict=True)
    return np.array([centers[start:end].mean(axis=0) for start, end in ends])
