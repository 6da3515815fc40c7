"""Plausibility checks of photos; every finding is one line that names what to check."""

from collections.abc import Iterator

import numpy as np

from geraf2._types import Floats
from geraf2.errors import UserError
from geraf2.scene.checks import Finding, error, format_mm, warning
from geraf2.scene.photos import PhotoSet

MIN_PHOTOS = 3
"""Least number of photos for a surface."""
_FEW_PHOTOS = 12
# A box is photographed from an arm's length; poses in mm or cm are far outside.
_NEAREST_M, _FARTHEST_M = 0.03, 20.0
# Cameras on rings leave gaps of 30 degrees or less.
_LARGEST_GAP_RAD = np.deg2rad(150.0)
# Least length of the mean up vector of upright pictures.
_COMMON_UP = 0.4
# Directions to the cameras of one ring lie in a plane, to this share of their spread.
_FLAT = 0.1
_SATURATED = 254
# A white label or a lamp saturates a few pixels, an over-exposed face more.
_MAX_SATURATED = 0.2
_SAME_POSITION_M = 1e-6


def check_photos(photos: PhotoSet) -> tuple[Finding, ...]:
    """List the findings on cameras and images, errors first."""
    if len(photos) < MIN_PHOTOS:
        return (error(f"needs at least {MIN_PHOTOS} photos that can be read, got {len(photos)}"),)
    positions = photos.positions
    if float(np.ptp(positions, axis=0).max()) < _SAME_POSITION_M:
        return (error("all cameras are at one position: such photos show no depth"),)
    focus = photos.focus()
    findings = [*_check_directions(photos, focus), *_check_exposure(photos)]
    distance = float(np.median(np.linalg.norm(positions - focus, axis=1)))
    if not _NEAREST_M <= distance <= _FARTHEST_M:
        findings.append(
            error(
                f"the cameras are {distance:.3g} m from their common focus; give the poses' unit "
                "(--unit mm, or metres per unit)"
            )
        )
    gap = largest_gap_rad(photos, focus)
    if gap >= _LARGEST_GAP_RAD:
        findings.append(
            warning(
                f"all cameras are on one side: {np.rad2deg(gap):.0f} degrees around the scene were "
                "photographed by none; the surface there is not seen"
            )
        )
    if len(photos) < _FEW_PHOTOS:
        findings.append(warning(f"only {len(photos)} photos; 20 to 200 make a good surface"))
    return tuple(sorted(findings, key=lambda finding: finding.severity))


def require_photos_in_view(
    photos: PhotoSet, radar_focus: Floats, standoff_m: float, where: object
) -> None:
    """Raise UserError unless the cameras view about the same point as the radar.

    radar_focus: point that the poses of the radar view, (3,) [m].
    standoff_m: distance of the antennas from it [m].
    """
    focus = photos.focus()
    apart = float(np.linalg.norm(focus - radar_focus))
    distance = float(np.median(np.linalg.norm(photos.positions - focus, axis=1)))
    # Camera and radar go around the same box: their distances from it differ by a few times at
    # most, with a wrong unit by ten or more.
    ratio = distance / standoff_m
    if apart > standoff_m or not 1.0 / 30.0 < ratio < 30.0:
        raise UserError(
            what="the cameras and the radar view different scenes",
            where=where,
            expected=f"a point near {format_mm(radar_focus)} mm, about {standoff_m:.2g} m away",
            got=f"{format_mm(focus)} mm, {distance:.3g} m away",
            hint="give the photos' unit (--unit) and frame (--to-radar)",
        )


def _check_directions(photos: PhotoSet, focus: Floats) -> Iterator[Finding]:
    n_away = sum(float(c.view_direction @ (focus - c.position)) <= 0.0 for c in photos.cameras)
    if n_away > 0.5 * len(photos):
        yield error(
            f"{n_away} of {len(photos)} cameras face away from their common focus; the "
            "camera axes are probably of the other convention (--camera-axes opencv or opengl)"
        )
        return
    outside = [
        name
        for name, camera in zip(photos.names, photos.cameras, strict=True)
        if not camera.contains(camera.project(focus[None])).all()
    ]
    if len(outside) > 0.5 * len(photos):
        yield error(
            f"{len(outside)} of {len(photos)} cameras do not show their common focus; check the "
            "poses and the handedness of their frame"
        )
    elif outside:
        yield warning(
            f"{len(outside)} of {len(photos)} photos do not show the focus of the others "
            f"(e.g. {outside[0]})"
        )


def largest_gap_rad(photos: PhotoSet, focus: Floats) -> float:
    """Largest angle around the focus without a camera, about the vertical [rad].

    For cameras on one ring the vertical is its axis, else the mean up direction of the pictures.
    Without a common one, it is the direction in which the cameras vary least from the focus.
    """
    lines = photos.positions - focus
    directions = lines / np.maximum(np.linalg.norm(lines, axis=1, keepdims=True), 1e-12)
    _, spread, axes = np.linalg.svd(directions - directions.mean(axis=0))
    up = -np.mean([camera.camera_to_world[:3, 1] for camera in photos.cameras], axis=0)
    if spread[2] < _FLAT * spread[1] or np.linalg.norm(up) < _COMMON_UP:
        up = axes[2]
    first = np.linalg.svd(up[None, :])[2][1]
    second = np.cross(up / np.linalg.norm(up), first)
    angles = np.sort(np.arctan2(directions @ second, directions @ first))
    return float(np.diff(np.concatenate([angles, angles[:1] + 2.0 * np.pi])).max())


def _check_exposure(photos: PhotoSet) -> Iterator[Finding]:
    burnt = []
    for index, image in enumerate(photos.images):
        saturated = image.min(axis=2) >= _SATURATED
        shown = saturated if photos.masks is None else saturated[photos.masks[index]]
        if shown.size and float(shown.mean()) > _MAX_SATURATED:
            burnt.append(photos.names[index])
    if burnt:
        yield warning(
            f"{len(burnt)} of {len(photos)} photos are over-exposed, more than "
            f"{100 * _MAX_SATURATED:.0f} % of their pixels white (e.g. {burnt[0]}); what is white "
            "shows no surface"
        )
