"""Glints: specular echoes as oriented points.

A monostatic specular echo comes from the point whose normal points at the antenna, so each peak
of a sub-aperture image gives a position and a normal (docs/math/echoes.md#glints).
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import KDTree

from geraf2._bounds import AngleRad, Bounded, Decibels, LengthM, Rounds, Share, SignedDb, SignedM
from geraf2._types import Bools, Floats, Ints, Progress
from geraf2.echoes.agreement import agreeing_pairs
from geraf2.echoes.ambiguity import without_grating_lobes
from geraf2.echoes.glint_set import Glints, strong_level
from geraf2.echoes.links import CLUTTER, FEW_PLANES, linked_to_strong
from geraf2.echoes.merging import BIAS_SHARE, SIGMA_SHARE, tangent_deviation
from geraf2.echoes.wall_delay import WallEcho, box_delay_m, learn_wall_delay
from geraf2.echoes.wall_paths import over_walls, shares_transmitters
from geraf2.errors import UserError
from geraf2.geometry.components import connected_labels
from geraf2.imaging.peaks import DETECTION_DB, PeakSet, box_spans, collect_peaks
from geraf2.imaging.subapertures import SubapertureConfig
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Capture, LosPrior, Wall

# Normals against the echo's strength a relative to the strong ones (98 % quantile), fitted to
# simulated figures: 2 degrees within 10 dB, 6 at -15 dB, 18 at -25 dB.
_NORMAL_SIGMA_RAD = 0.03
# Of a range where no echoes merge: positions of the antennas and the walls' delay [m].
_POSITION_SIGMA_M = 2e-4


# Least height over the noise among scatterers [dB].
_CLUTTER_MARGIN_DB = 15.0


GLINTS_VERSION = 16
"""Raised when the same capture and settings give other glints, or others are dropped."""


# Share of peaks that a coarse raster shows elsewhere of which the user is told.
_TOLD_SHARE = 0.01

# A cluster that few planes see needs this share of all strength: of 12 planes and more at most two,
# of fewer one, where it lies farther than so from clusters that have it. Of shoe and bunny, 17
# planes and more, clusters with less have medians of 8 to 43 mm off the truth; ghosts of few planes
# have 0.001 to 0.004 at 58 to 71 mm, true clusters of one plane lie within 20 mm of others.
_LONE_M, _LONE_SHARE = 0.04, 0.01


@dataclass(frozen=True, kw_only=True)
class GlintConfig(Bounded):
    """What counts as a glint."""

    subaperture: SubapertureConfig = field(default_factory=SubapertureConfig)
    """Size and sampling of the images."""
    dynamic_range_db: Decibels | None = None
    """Peaks weaker than the image's largest by more are dropped [dB]; None: 18 to 26, by trust."""
    noise_margin_db: SignedDb | None = None
    """Least height of a peak over the noise floor of its range bin [dB]; None: 12, or 15 in
    clutter."""
    wall_margin_m: SignedM = 0.012
    """Glints closer than this to the prior's surface are the wall's own [m]."""
    neighbor_radius_m: LengthM = 0.008
    """A glint needs neighbours that agree with it within this distance [m]."""
    neighbor_offset_m: LengthM = 0.0025
    """Agreement: distance of the neighbour from the glint's tangent plane [m]."""
    neighbor_angle_rad: AngleRad = 0.5
    """Agreement: angle between both normals [rad]."""
    neighbor_count: Rounds | None = None
    """Agreeing neighbours needed; None means 2, or 1 below 12 planes."""
    cluster_link_m: LengthM = 0.012
    """Glints this near to each other belong to one cluster [m]."""
    cluster_share: Share = 0.001
    """Clusters with less than this share of the strength of all glints are dropped."""
    range_correction_m: SignedM | None = None
    """Taken off every range of an echo from inside the box [m]; None: from the walls."""

    @property
    def least_noise_margin_db(self) -> float:
        """The margin that every peak has to have [dB]."""
        return DETECTION_DB if self.noise_margin_db is None else self.noise_margin_db


def find_glints(
    capture: Capture,
    prior: LosPrior,
    config: GlintConfig | None = None,
    *,
    peaks: PeakSet | None = None,
    num_threads: int | None = None,
    progress: Progress | None = None,
    tell: Callable[[str], None] | None = None,
) -> Glints:
    """Glints of what is inside the prior's box.

    Where many hang on to no strong one, there are scatterers, and those that do not are dropped.

    capture: the scan.
    prior: outer surface of the box; its walls, or else the capture's, give the range correction.
    config: what counts as a glint.
    peaks: of the capture's planes; collected when None.
    num_threads: torch's number when torch is loaded, else all cores, when None.
    progress: called with the fraction done.
    tell: called with what the user should know: grating lobes of a coarse raster.

    Returns the oriented points, positions (n_glints, 3) [m]. Raises UserError where no glint lies
    inside the box; the message says what was seen instead.

    >>> capture, truth = geraf2.examples.small_capture()
    >>> glints = geraf2.find_glints(capture, geraf2.LosPrior.from_box(geraf2.examples.BOX_M))
    >>> glints.positions.shape == glints.normals.shape == (len(glints), 3)
    True
    """
    config = config or GlintConfig()
    if peaks is None:
        peaks = collect_peaks(
            capture,
            prior,
            config.subaperture,
            config.least_noise_margin_db,
            num_threads=num_threads,
            progress=progress,
        )
    peaks = peaks_around(capture, prior, peaks, config)
    lobes = without_grating_lobes(peaks, capture.poses, prior.bounds)
    if tell is not None and lobes.n_moved + lobes.n_dropped > _TOLD_SHARE * len(peaks):
        tell(
            f"grating lobes of sparse sampling: of {len(peaks)} peaks {lobes.n_moved} were moved "
            f"to their true direction, and {lobes.n_dropped} that their neighbours do not confirm "
            "were left out"
        )
    raw, positions = peaks_inside(capture, prior, lobes.peaks, config, num_threads=num_threads)
    n_poses = len(capture.poses)
    walls = prior.walls or capture.walls
    axes = [pose.axes if shares_transmitters(pose) else None for pose in capture.poses]
    glints = _believed(raw, positions, config, walls, axes)
    linked = linked_to_strong(glints, n_poses)
    if linked.mean() < 1.0 - CLUTTER:
        if config.noise_margin_db is None:
            clear = raw.margins_db >= _CLUTTER_MARGIN_DB
            glints = _believed(raw.select(clear), positions[clear], config, walls, axes)
            linked = linked_to_strong(glints, n_poses)
        glints = glints.select(linked)
    return glints


def _believed(
    raw: PeakSet,
    positions: Floats,
    config: GlintConfig,
    walls: tuple[Wall, ...],
    axes: list[Floats | None],
) -> Glints:
    """Glints that agree with others, of clusters that carry weight; UserError if there is none."""
    n_poses, n_needed = len(axes), config.neighbor_count
    if n_needed is None:
        n_needed = 2 if n_poses >= FEW_PLANES else 1
    agreement = count_agreeing(positions, -raw.directions, config, raw.levels_db)
    dynamic_range_db = config.dynamic_range_db or trusted_depth_db(
        raw.levels_db, agreement, n_needed
    )
    trusted = raw.levels_db >= -dynamic_range_db
    raw, positions = raw.select(trusted), positions[trusted]
    consistent = count_agreeing(positions, -raw.directions, config) >= n_needed
    if not consistent.any():
        raise _nothing_consistent(len(positions), n_needed, config)
    raw, positions = raw.select(consistent), positions[consistent]
    direct = ~over_walls(
        raw.centers, raw.directions, raw.ranges_m, positions, raw.planes, axes, walls
    )
    raw, positions = raw.select(direct), positions[direct]
    connected = major_clusters(positions, raw.magnitudes, config, poses=raw.planes, n_poses=n_poses)
    raw, positions = raw.select(connected), positions[connected]
    return with_uncertainty(raw, positions)


def peaks_around(capture: Capture, prior: LosPrior, peaks: PeakSet, config: GlintConfig) -> PeakSet:
    """Peaks at the ranges of the prior's box that are as strong as glints may be weak."""
    near = peaks.within(box_spans(capture.poses, prior))
    return near.select(near.levels_db >= -(config.dynamic_range_db or _TRUST_RANGE_DB[1]))


def peaks_inside(
    capture: Capture,
    prior: LosPrior,
    peaks: PeakSet,
    config: GlintConfig,
    *,
    num_threads: int | None = None,
) -> tuple[PeakSet, Floats]:
    """Peaks from inside the box, and their places with the walls' delay subtracted, (n, 3) [m].

    Raises UserError where there is none.
    """
    scene = MeshScene(prior.vertices, prior.faces, num_threads=num_threads)
    points = peaks.points
    depth = -scene.signed_distance(points) if len(points) else np.zeros(0)
    correction = _range_correction(capture, prior, scene, config, peaks, depth)
    positions = points - peaks.directions * correction[:, None]
    inside = depth > config.wall_margin_m
    if not inside.any():
        raise _nothing_found(peaks, depth, config)
    return peaks.select(inside), positions[inside]


# Automatic dynamic range: at least the first, at most the second.
_TRUST_RANGE_DB = (18.0, 26.0)


def _range_correction(
    capture: Capture,
    prior: LosPrior,
    scene: MeshScene,
    config: GlintConfig,
    raw: PeakSet,
    depth: Floats,
) -> Floats:
    """Excess path to take off each range [m], (n_glints,)."""
    if config.range_correction_m is not None:
        return np.full(len(raw.ranges_m), config.range_correction_m)
    walls = prior.walls or capture.walls
    if walls:
        return box_delay_m(scene, walls, raw.centers, raw.directions, raw.ranges_m)
    learned = learn_wall_delay(
        WallEcho(
            centers=raw.centers,
            directions=raw.directions,
            ranges_m=raw.ranges_m,
            magnitudes=raw.magnitudes,
            depth_m=depth,
        ),
        scene,
    )
    return np.full(len(raw.ranges_m), learned)


def count_agreeing(
    positions: Floats, normals: Floats, config: GlintConfig, levels_db: Floats | None = None
) -> Ints:
    """Neighbours that agree with each glint, (n,); of greater level [dB] where levels are given."""
    i, j = agreeing_pairs(
        positions,
        normals,
        radius_m=config.neighbor_radius_m,
        offset_m=config.neighbor_offset_m,
        angle_rad=config.neighbor_angle_rad,
    )
    if levels_db is not None:
        i = i[levels_db[j] > levels_db[i]]
    return np.bincount(i, minlength=len(positions))


def trusted_depth_db(levels_db: Floats, agreement: Ints, n_needed: int) -> float:
    """Deepest level at which most echoes still agree with stronger ones [dB].

    Echoes of surfaces line up with stronger echoes beside them; side lobes, multipath and
    clutter do not. The threshold goes down in steps of 2 dB for as long as at least 60 % of the
    next step's echoes have the neighbours they need.
    """
    shallow, deep = _TRUST_RANGE_DB
    for level in np.arange(shallow, deep, 2.0):
        step = (levels_db < -level) & (levels_db >= -level - 2.0)
        if step.sum() < 20:  # too few to judge by
            continue
        if float((agreement[step] >= n_needed).mean()) < 0.6:
            return float(level)
    return deep


def major_clusters(
    positions: Floats,
    magnitudes: Floats,
    config: GlintConfig,
    *,
    poses: Ints | None = None,
    n_poses: int = 0,
) -> Bools:
    """Glints of clusters that carry a noticeable share of all strength, (n_glints,).

    Side lobes of a flat face, and its interference with a wall, make a few small clusters far
    from everything else; they agree with their neighbours and would become floating bodies. One
    that one or two planes see has to carry more: what a raised plane sees in a corner of the box,
    paths over figure and wall.

    poses: plane of each glint, (n_glints,). n_poses: planes of the scan.
    """
    n = len(positions)
    pairs = KDTree(positions).query_pairs(config.cluster_link_m, output_type="ndarray")
    label = connected_labels(pairs[:, 0], pairs[:, 1], n)
    strength = np.bincount(label, weights=magnitudes)
    share = strength / strength.sum()
    keep, large = share >= config.cluster_share, (share >= _LONE_SHARE)[label]
    if poses is not None and large.any():
        n_few, least_m = (2, 0.0) if n_poses >= FEW_PLANES else (1, _LONE_M)
        away_m = KDTree(positions[large]).query(positions)[0]
        for number in np.flatnonzero(keep & (share < _LONE_SHARE)):
            own = label == number
            keep[number] = len(set(poses[own])) > n_few or away_m[own].min() <= least_m
    return np.asarray(keep[label])


def with_uncertainty(raw: PeakSet, positions: Floats, known: Glints | None = None) -> Glints:
    """Glints at positions (n, 3) [m], freed of the bias of merged echoes, with uncertainties.

    known: glints found before: neighbours, and the scale of strengths; else these are their own.
    """
    normals = -raw.directions
    others = None if known is None else (known.positions, known.normals)
    deviation = tangent_deviation(positions, normals, others)
    strong = strong_level(raw.magnitudes if known is None else known.strengths)
    relative = np.minimum(1.0, raw.magnitudes / strong)
    noise = raw.noise / raw.magnitudes
    return Glints(
        positions=positions - (BIAS_SHARE * deviation)[:, None] * normals,
        normals=normals,
        strengths=raw.magnitudes,
        position_sigma_m=np.hypot(_POSITION_SIGMA_M, SIGMA_SHARE * deviation),
        normal_sigma_rad=_NORMAL_SIGMA_RAD * np.sqrt(1.0 + (0.3 / relative) ** 2 + noise**2),
        poses=raw.planes,
    )


def _nothing_found(raw: PeakSet, depth: Floats, config: GlintConfig) -> UserError:
    if len(depth) == 0:
        seen = f"no echo {config.least_noise_margin_db:g} dB above the noise at the box's range"
    else:
        n_wall = int((np.abs(depth) <= config.wall_margin_m).sum())
        n_outside = int((depth < -config.wall_margin_m).sum())
        nearest = float(raw.ranges_m.min())
        farthest = float(raw.ranges_m.max())
        seen = (
            f"{n_wall} echoes of the box's walls and {n_outside} outside it, "
            f"at ranges from {nearest:.2f} to {farthest:.2f} m"
        )
    return UserError(
        "no glint inside the box",
        expected="echoes of the content",
        got=seen,
        hint="check that the box is in the scan's frame and in metres, the instrument delay "
        "path_bias_m, and that the box is not empty",
    )


def _nothing_consistent(n_points: int, n_needed: int, config: GlintConfig) -> UserError:
    return UserError(
        "no glint inside the box",
        expected=f"echoes with {n_needed} agreeing neighbours within "
        f"{1e3 * config.neighbor_radius_m:g} mm",
        got=f"{n_points} scattered echoes",
        hint="check the antenna positions, the frame and the instrument delay path_bias_m",
    )
