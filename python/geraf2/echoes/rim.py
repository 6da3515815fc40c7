"""Glints of the aperture's rim.

The middle of a whole sub-aperture stays half of its side away from the rim, so that normals which
point at the rim are left out. Smaller ones reach there, but blur echoes together; their peaks are
accepted where glints that are known support them (docs/math/echoes.md#rim-sub-apertures).
"""

from dataclasses import dataclass, replace

import numpy as np

from geraf2._bounds import Bounded, Decibels, LengthM
from geraf2._types import Progress
from geraf2.echoes.glint_set import Glints
from geraf2.echoes.glints import GlintConfig, as_glints, box_volume_m3, candidates_around
from geraf2.echoes.labels import continuing
from geraf2.imaging.peaks import collect_peaks
from geraf2.scene import Capture, LosPrior


@dataclass(frozen=True, kw_only=True)
class RimConfig(Bounded):
    """What is believed of the sub-apertures at the rim."""

    sizes_m: tuple[LengthM, ...] = (0.06, 0.04)
    """Sides to which sub-apertures are cut at the rim [m]."""
    dynamic_range_db: Decibels = 30.0
    """Peaks weaker than the image's largest by more are dropped [dB]."""


def find_rim_glints(
    capture: Capture,
    prior: LosPrior,
    glints: Glints,
    config: RimConfig | None = None,
    look: GlintConfig | None = None,
    *,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> Glints:
    """Glints seen from the rim of each plane that continue known ones; possibly none.

    glints: those of whole sub-apertures, from `find_glints`.
    config: what is believed.
    look: how glints were found: sub-apertures, margins, range correction, least probability.
    """
    config, look = config or RimConfig(), look or GlintConfig()
    sizes = tuple(size for size in config.sizes_m if size < look.subaperture.size_m)
    if not sizes or len(glints) == 0:
        return glints.select(np.zeros(len(glints), dtype=bool))
    peaks = collect_peaks(
        capture,
        prior,
        replace(look.subaperture, rim_sizes_m=sizes),
        look.noise_margin_db,
        reach_m=(0.0, 0.0),
        num_threads=num_threads,
        progress=progress,
    )
    closer = replace(look, dynamic_range_db=config.dynamic_range_db)
    peaks, found = candidates_around(capture, prior, peaks, closer, num_threads=num_threads)
    inside = found.depth_m > look.wall_margin_m
    probability = continuing(peaks, found, box_volume_m3(prior), inside, glints)
    keep = inside & (probability > look.least_probability)
    if not keep.any():
        return glints.select(np.zeros(len(glints), dtype=bool))
    return as_glints(peaks, found.select(keep), probability[keep], glints)
