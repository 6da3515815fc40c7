"""Echoes of the box's walls, and the instrument delay at which they lie on the prior.

A flat wall answers where it is seen along its normal. Whatever the instrument delay, the
direction of such an echo is right, and its range less the distance to the prior's surface is the
same for all of them; the content's echoes have no such common offset (docs/math.md, calibration).
"""

from dataclasses import dataclass

import numpy as np

from geraf2._types import Bools, Floats, Ints
from geraf2.errors import UserError
from geraf2.geometry.triangles import unit_normals
from geraf2.imaging.subapertures import SubapertureConfig, pose_images
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, LosPrior, Wall

WALL_MIDDLE_M = 0.0025
"""Optical middle of a wall behind its outer face where nothing is known of it [m]."""
WALL_MIDDLE_SIGMA_M = 0.0015
"""Its uncertainty: board of 2 to 7 mm [m]."""

# The wall's echo is strong, but the figure's may be 20 dB stronger.
_DYNAMIC_RANGE_DB = 26.0
_NOISE_MARGIN_DB = 15.0
# Half as many sub-apertures and directions as glints need: 4 m of wall give hundreds of echoes.
_SUBAPERTURES = SubapertureConfig(step_m=0.04, direction_oversampling=2.0)
# The offset of the walls stands out as a peak of this width; it covers a prior that is 5 mm off.
_OFFSET_SIGMA_M = 0.004
_OFFSET_STEP_M = 0.001
# The far walls make a second peak, a box behind the first; the content may hide some of the
# nearest wall's echoes, never most.
_FIRST_PEAK_SHARE = 0.4
_MIN_ECHOES = 12


@dataclass(frozen=True, kw_only=True, eq=False)
class WallEchoes:
    """Peaks of sub-aperture images, before any is known to be a wall's."""

    centers: Floats
    """Of the sub-aperture, (n, 3) [m]."""
    directions: Floats
    """From the centre to the echo, unit, (n, 3)."""
    ranges_m: Floats
    """One-way distance by the capture's instrument delay, (n,) [m]."""
    poses: Ints
    """Index of the pose, (n,)."""

    def select(self, keep: Bools) -> "WallEchoes":
        """Subset by mask."""
        return WallEchoes(**{name: getattr(self, name)[keep] for name in self.__dataclass_fields__})


def collect_echoes(
    capture: Capture,
    prior: LosPrior,
    range_shift_m: tuple[float, float],
    *,
    num_threads: int | None = None,
) -> WallEchoes:
    """Peaks of all poses at the prior's distance, or shifted by an unknown delay.

    range_shift_m: how much nearer (negative) and farther than the prior to look, one way [m].
    """
    waveform = capture.waveform
    parts = []
    for number, pose in enumerate(capture.poses):
        if pose.n_antennas == 0:
            continue
        distance = np.linalg.norm(prior.corners[None] - pose.phase_centers[::7, None], axis=2)
        near = float(((prior.corners - pose.phase_centers.mean(axis=0)) @ pose.axes[0]).min())
        low = max(near - 0.02 + range_shift_m[0], 0.5 * waveform.range_cell_m)
        high = min(
            float(distance.max()) + 0.02 + range_shift_m[1], low + waveform.unambiguous_range_m
        )
        target = prior.bounds.mean(axis=0)
        images = pose_images(pose, waveform, target, (low, max(high, low + 0.05)), _SUBAPERTURES)
        echoes = images.echoes(_DYNAMIC_RANGE_DB, _NOISE_MARGIN_DB, num_threads=num_threads)
        n = len(echoes.ranges_m)
        parts.append((echoes.centers, echoes.directions, echoes.ranges_m, np.full(n, number)))
    if not parts:
        raise UserError(what="no pose has antennas")
    centers, directions, ranges, poses = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    return WallEchoes(
        centers=centers, directions=directions, ranges_m=ranges, poses=poses.astype(np.int64)
    )


def wall_middle_m(walls: tuple[Wall, ...]) -> tuple[float, float]:
    """How far behind the outer face the wall's two faces echo, and the uncertainty [m].

    n t / 2 for thickness t and index n: both faces lie in one range cell.
    """
    if not walls:
        return WALL_MIDDLE_M, WALL_MIDDLE_SIGMA_M
    middle = 0.5 * float(np.sqrt(walls[0].permittivity)) * walls[0].thickness_m
    # Range error of a wall's echo, measured on simulated cartons; and a tenth of the wall.
    return middle, float(np.hypot(2.5e-4, 0.1 * middle))


@dataclass(frozen=True, kw_only=True, eq=False)
class WallOffsets:
    """Echoes along a face's normal, and how far behind the face they seem to lie."""

    echoes: WallEchoes
    offsets_m: Floats
    """Range less distance of the prior's surface, (n,) [m]."""
    faces: Ints
    """Triangle of the prior that the line of sight meets, (n,)."""
    normals: Floats
    """Outward normal there, (n, 3)."""


def wall_offsets(echoes: WallEchoes, scene: MeshScene, max_angle_rad: float) -> WallOffsets:
    """Keep echoes that come from along the normal of the face their line of sight meets."""
    distance, face = scene.closest_hit(echoes.centers, echoes.directions)
    normals = unit_normals(scene.vertices[scene.faces])
    met = normals[np.maximum(face, 0)]
    cosine = -np.einsum("ij,ij->i", echoes.directions, met)
    keep = (face >= 0) & (cosine > np.cos(max_angle_rad))
    return WallOffsets(
        echoes=echoes.select(keep),
        offsets_m=(echoes.ranges_m - np.where(np.isfinite(distance), distance, 0.0))[keep],
        faces=face[keep],
        normals=met[keep],
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class OffsetPeak:
    """Where the walls stand out among the offsets."""

    offset_m: float
    n_echoes: int
    """Echoes within 1 cm of it."""
    candidates_m: Floats
    """Offsets looked at, (n,) [m]."""
    density: Floats
    """Echoes per candidate, smoothed, (n,)."""


def find_wall_peak(offsets_m: Floats, search_m: tuple[float, float]) -> OffsetPeak:
    """First offset at which many echoes agree.

    offsets_m: (n,) [m].
    search_m: smallest and largest offset to look at [m].

    Raises UserError: fewer than twelve echoes agree.
    """
    n_steps = max(2, round((search_m[1] - search_m[0]) / _OFFSET_STEP_M))
    candidates = np.linspace(*search_m, n_steps)
    scaled = (candidates[:, None] - offsets_m[None]) / _OFFSET_SIGMA_M
    density = np.exp(-0.5 * scaled**2).sum(axis=1)
    maximum = np.concatenate(
        [[False], (density[1:-1] >= density[:-2]) & (density[1:-1] > density[2:]), [False]]
    )
    strong = np.nonzero(maximum & (density >= _FIRST_PEAK_SHARE * density.max()))[0]
    offset = float(candidates[strong[0]]) if len(strong) else 0.0
    n_echoes = int((np.abs(offsets_m - offset) < 0.01).sum()) if len(strong) else 0
    if n_echoes < _MIN_ECHOES:
        raise UserError(
            what="the walls of the box do not stand out",
            expected=f"at least {_MIN_ECHOES} echoes along the prior's faces at one offset between "
            f"{search_m[0]:g} and {search_m[1]:g} m",
            got=n_echoes,
            hint="check that the prior lies in the scan's frame and in metres; a scan that faces "
            "no wall needs --delay-from reflector or sharpness",
        )
    return OffsetPeak(offset_m=offset, n_echoes=n_echoes, candidates_m=candidates, density=density)
