"""Second look: what the rim of the aperture sees.

The middle of a whole sub-aperture stays half of its side away from the rim, so that normals which
point at the rim are left out. Smaller ones reach there, but blur echoes together; what they show is
believed where it continues a glint that is known (docs/math/echoes.md#rim-sub-apertures).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geraf2._bounds import Bounded, Decibels, LengthM, Rounds
from geraf2._types import Bools, Floats, Progress
from geraf2.echoes.glint_set import Glints
from geraf2.echoes.glints import GlintConfig, peaks_around, peaks_inside, with_uncertainty
from geraf2.echoes.links import LinkConfig, smooth_pairs, spread
from geraf2.errors import UserError
from geraf2.imaging.peaks import collect_peaks
from geraf2.scene import Capture, LosPrior, Pose
from geraf2.scene.aperture import apertures_of, own_mirror_points


@dataclass(frozen=True, kw_only=True)
class RimConfig(Bounded):
    """What is believed of the sub-apertures at the rim."""

    sizes_m: tuple[LengthM, ...] = (0.06, 0.04)
    """Sides to which sub-apertures are cut at the rim [m]."""
    dynamic_range_db: Decibels = 30.0
    """Peaks weaker than the image's largest by more are dropped [dB]."""
    aperture_step_m: LengthM = 0.035
    """An echo continues a glint of the same plane, seen from a place on it at most this far from
    its own [m], to which it has the chord of a link (`LinkConfig`)."""
    rounds: Rounds = 2
    """Rounds in which what was accepted is continued in turn."""


def find_rim_glints(
    capture: Capture,
    prior: LosPrior,
    glints: Glints,
    config: RimConfig | None = None,
    look: GlintConfig | None = None,
    links: LinkConfig | None = None,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> Glints:
    """Glints seen from the rim of each plane that continue known ones; possibly none.

    glints: those of whole sub-apertures, from `find_glints`.
    config: what is believed.
    look: how glints were found: size of whole sub-apertures, noise margin, range correction.
    links: reach and chord of two glints that fit to each other.
    """
    config, look = config or RimConfig(), look or GlintConfig()
    sizes = tuple(size for size in config.sizes_m if size < look.subaperture.size_m)
    if not sizes or len(glints) == 0:
        return glints.select(np.zeros(len(glints), dtype=bool))
    closer = replace(look, dynamic_range_db=config.dynamic_range_db)
    peaks = collect_peaks(
        capture,
        prior,
        replace(look.subaperture, rim_sizes_m=sizes),
        look.least_noise_margin_db,
        reach_m=(0.0, 0.0),
        num_threads=num_threads,
        progress=progress,
    )
    peaks = peaks_around(capture, prior, peaks, closer)
    try:
        raw, positions = peaks_inside(capture, prior, peaks, look, num_threads=num_threads)
    except UserError:  # nothing to be seen from the rim
        return glints.select(np.zeros(len(glints), dtype=bool))
    found = with_uncertainty(raw, positions, glints)
    centers = np.concatenate([mirror_centers(glints, capture.poses), raw.centers])
    everything = glints.join(found)
    known = np.arange(len(everything)) < len(glints)
    return found.select(continued(everything, centers, known, config, links)[len(glints) :])


def mirror_centers(glints: Glints, poses: Sequence[Pose]) -> Floats:
    """Position on its plane of antennas that received each glint, (n_glints, 3) [m]."""
    apertures = apertures_of(poses)
    return own_mirror_points(glints.positions, glints.normals, apertures, glints.poses).positions_m


def continued(
    glints: Glints,
    centers: Floats,
    known: Bools,
    config: RimConfig,
    links: LinkConfig | None = None,
) -> Bools:
    """Known glints and those that continue them, (n_glints,).

    glints: known and new ones.
    centers: where each was seen from, (n_glints, 3) [m].
    known: which are known, (n_glints,).
    config, links: distances of a continuation.
    """
    links = links or LinkConfig()
    i, j = smooth_pairs(
        glints,
        reach_m=links.reach_m,
        chord_m=links.chord_m,
        within=glints.poses,
    )
    linked = np.linalg.norm(centers[i] - centers[j], axis=1) < config.aperture_step_m
    return spread(known, (i[linked], j[linked]), config.rounds)
