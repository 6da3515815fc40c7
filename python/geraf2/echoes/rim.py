"""Glints of rim sub-apertures.

The centre of a whole sub-aperture is half a side away from the rim of the aperture, so it misses
normals that point at the rim. Smaller sub-apertures reach the rim, but echoes merge in them. Their
peaks are accepted if known glints support them (docs/math/echoes.md#rim-sub-apertures).
"""

from dataclasses import dataclass, replace

import numpy as np

from geraf2._bounds import Bounded, Decibels, LengthM
from geraf2._types import Progress
from geraf2.echoes.glint_set import Glints
from geraf2.echoes.glints import GlintConfig, as_glints, candidates_around
from geraf2.echoes.labels import continuing
from geraf2.imaging.peaks import KeptPeaks
from geraf2.scene import Capture, LosPrior


@dataclass(frozen=True, kw_only=True)
class RimConfig(Bounded):
    """Settings of rim sub-apertures."""

    sizes_m: tuple[LengthM, ...] = (0.06, 0.04)
    """Sides of the sub-apertures at the rim [m]."""
    dynamic_range_db: Decibels = 30.0
    """Largest ratio of an image's strongest peak to a kept peak [dB]."""


def find_rim_glints(
    capture: Capture,
    prior: LosPrior,
    glints: Glints,
    config: RimConfig | None = None,
    first: GlintConfig | None = None,
    *,
    kept: KeptPeaks | None = None,
    num_threads: int | None = None,
    progress: Progress | None = None,
) -> Glints:
    """Glints of the rim of each plane that continue known ones; possibly none.

    glints: those of whole sub-apertures, from `find_glints`.
    config: settings of rim sub-apertures.
    first: settings that found `glints`.
    kept: peaks of the capture's planes, which also keeps those of their rims.
    """
    config, first = config or RimConfig(), first or GlintConfig()
    sizes = tuple(size for size in config.sizes_m if size < first.subaperture.size_m)
    if not sizes or len(glints) == 0:
        return glints.select(np.zeros(len(glints), dtype=bool))
    kept = kept or KeptPeaks(
        prior, first.subaperture, first.noise_margin_db, num_threads=num_threads
    )
    rims = kept.rim(prior, replace(first.subaperture, rim_sizes_m=sizes))
    peaks = rims.of(capture, progress=progress)
    settings = replace(first, dynamic_range_db=config.dynamic_range_db)
    peaks, found = candidates_around(capture, prior, peaks, settings, num_threads=num_threads)
    inside = found.depth_m > first.wall_margin_m
    probability = continuing(peaks, found, prior.expected_volume_m3, inside, glints)
    keep = inside & (probability > first.min_probability)
    if not keep.any():
        return glints.select(np.zeros(len(glints), dtype=bool))
    return as_glints(peaks, found.select(keep), probability[keep], glints)
