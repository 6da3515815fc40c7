"""Labels of peaks: one joint inference over the graph of all peaks (docs/math/echoes.md#labels).

Each candidate of `hypotheses` competes with the other candidates of its peak and with clutter,
which is uniform over the box. A candidate is likely if the tangent planes of others predict it: two
points of a smooth surface satisfy (p_i - p_j) . (n_i + n_j) / 2 = 0 to third order. Echoes of the
box's walls are candidates, too. They explain grating lobes of a wall's flash.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from scipy import sparse

from geraf2._types import Bools, Floats, Ints
from geraf2.echoes.hypotheses import Candidates
from geraf2.echoes.noise import ECHO_NOISE
from geraf2.imaging.peaks import DETECTION_DB, PeakSet
from geraf2.io.points import cloud_bytes
from geraf2.ops.pair_density import PairModel, PeakPoints, pair_densities

_PEAK_M, _TURN_RAD = 0.00116, 0.184
"""Standard deviations of peaks that predict each other, along the normal [m], and of each component
of the normal [rad]; these and what follows are maximum likelihood values of labels of simulated
scans with a truth (docs/math/echoes.md#labels)."""
_SPREAD_M = 0.0057
"""Standard deviation of the distance along the surface at which points predict each other [m]."""
_REACH_M = 0.02
"""Largest distance of a pair [m]."""
_ALIKE = 0.5
"""Least cosine between the normals of a pair."""
_ALONE = 1.30
"""Support of a surface point without neighbours, in units of the clutter density."""
_OTHER_SCALE, _OTHER_POWER = 1.51, 0.758
"""Scale and exponent of the support by other planes; neighbours have common errors."""
_SHARED = 0.405
"""Exponent of the clutter density that reduces the support, because of common errors."""
_FLOOR = 0.375
"""Least share of clutter among the peaks in the box."""
_LOG_ODDS = -2.64
"""Prior log odds of a strong peak at the noise level against clutter."""
_PER_STRENGTH_DB, _PER_MARGIN_DB = 0.0467, 0.0273
"""Change of the log odds with strength and with the ratio to the noise [1/dB]."""
_MAX_MARGIN_DB = 40.0
"""Ratio to the noise above which the noise has no effect [dB]."""
_POINTS_AT_ONCE = 2000
"""So many have about 5 MB of pairs."""
_NEGLIGIBLE = 1e-6
"""Support that is neglected, relative to a neighbour at the same position."""
_ROUNDS = 6
"""Iterations of the fixed point; more change at most 2 % of the labels."""


class Label(IntEnum):
    """Kind of a peak."""

    CLUTTER = 0
    """No surface: noise, side lobe, multipath."""
    DIRECT = 1
    """Specular return of the content, in the direction of the image."""
    ALIAS = 2
    """Specular return of the content, shown by the image as a grating lobe."""
    WALL = 3
    """Echo of the box's wall, or its grating lobe."""
    OUTSIDE = 4
    """Echo from outside the box."""
    SEEN_THROUGH = 5
    """Return from behind a dielectric front face."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LabelledPeaks:
    """Most probable candidate of each peak."""

    candidates: Candidates
    """(n,), at most one per peak."""
    labels: Ints
    """`Label` of each candidate, (n,)."""
    probability: Floats
    """Probability of a specular return of the content, (n,)."""

    def on_faces(self, index: Ints, front: Bools, back: Bools) -> "LabelledPeaks":
        """Relabel the peaks of plastic, of which index are on faces or clutter, (n,) each."""
        labels, probability = self.labels.copy(), self.probability.copy()
        returned = np.where(self.candidates.is_alias[index], Label.ALIAS, Label.DIRECT)
        seen = np.where(front, returned, np.where(back, Label.SEEN_THROUGH, Label.CLUTTER))
        labels[index], probability[index] = seen, np.where(front, probability[index], 0.0)
        return replace(self, labels=labels, probability=probability)

    def cloud_bytes(self) -> bytes:
        """PLY file of the points with normals, probabilities and labels."""
        labels = np.asarray(self.labels, dtype=np.uint8)
        columns = {"probability": self.probability, "label": labels}
        names = " ".join(f"{label.value} {label.name.lower()}" for label in Label)
        found = self.candidates
        return cloud_bytes(found.positions, found.normals, columns, [f"label {names}"])

    def counts(self) -> dict[str, int]:
        """Count the peaks of each label, for run.json."""
        return {
            label.name.lower(): int((self.labels == label).sum())
            for label in Label
            if (self.labels == label).any()
        }


@dataclass(frozen=True, kw_only=True)
class Clutter:
    """What a return competes with in a scan; see `posterior`."""

    support: float
    """Of a neighbour at the same place, in units of the density of clutter."""
    strong: float
    """Magnitude of the strongest returns."""

    @classmethod
    def of(
        cls, peaks: PeakSet, found: Candidates, labelled: LabelledPeaks, volume_m3: float
    ) -> "Clutter":
        """Find it from labelled peaks; arguments as those of `label_peaks`."""
        inside = found.depth_m > 0.0
        direct = np.unique(found.peaks[inside & ~found.is_alias])
        explained = np.zeros(len(peaks))
        explained[labelled.candidates.peaks] = labelled.probability
        n_clutter = float((1.0 - explained[direct]).sum()) + _FLOOR * max(len(direct), 1)
        return cls(
            support=volume_m3 * np.pi / n_clutter * _peak_density(),
            strong=float(np.quantile(peaks.magnitudes[found.peaks[inside]], 0.98)),
        )

    def log_odds(self, own: Floats, other: Floats, magnitude: Floats) -> Floats:
        """Log odds of returns that just stand out of the noise, of the shape of all arguments.

        own, other: neighbours at the same place, of the same plane and of others.
        """
        below_db = 20.0 * np.log10(np.minimum(magnitude / self.strong, 1.0))
        support = (
            np.log(_ALONE + self.support * own)
            + _OTHER_POWER * np.log1p(self.support * other / _OTHER_SCALE)
            - _SHARED * np.log(self.support)
        )
        return np.asarray(
            _LOG_ODDS + _PER_STRENGTH_DB * below_db + _PER_MARGIN_DB * DETECTION_DB + support
        )

    def numbers(self) -> dict[str, float]:
        """For run.json."""
        return {"support_over_clutter": self.support, "strong_magnitude": self.strong}


def label_peaks(
    peaks: PeakSet, found: Candidates, volume_m3: float, wall_margin_m: float
) -> LabelledPeaks:
    """Label each peak, with its probability of a return of the content.

    found: candidates of the peaks.
    volume_m3: of the box, over which clutter is uniform [m^3].
    wall_margin_m: half thickness of the layer with the wall's own echoes [m].
    """
    inside = found.depth_m > wall_margin_m
    share = posterior(peaks, found, volume_m3, inside)
    order = np.lexsort((share, found.peaks))
    last = np.append(np.diff(found.peaks[order]) > 0, np.ones(min(len(order), 1), dtype=bool))
    best = order[last]
    chosen, inside, probable = found.select(best), inside[best], share[best]
    labels = np.where(inside, np.where(chosen.is_alias, Label.ALIAS, Label.DIRECT), Label.WALL)
    labels = np.where(chosen.depth_m < -wall_margin_m, Label.OUTSIDE, labels)
    labels = np.where(inside & (probable <= 0.5), Label.CLUTTER, labels)
    return LabelledPeaks(
        candidates=chosen, labels=labels, probability=np.where(inside, probable, 0.0)
    )


def posterior(peaks: PeakSet, found: Candidates, volume_m3: float, inside: Bools) -> Floats:
    """Probability of each candidate, (n,); those of a peak and of clutter sum to 1.

    The odds of a candidate against clutter are

        presence prior (alone + r_s) (1 + r_o / scale)^power / r_0^shared

    r_s and r_o are the support by neighbours of its own plane and of other planes, in units of the
    clutter density: sums of `pair_densities` times the neighbours' probabilities. r_0 is the
    support by a neighbour at the same position.

    peaks: of the candidates. found: (n,). volume_m3: of the box [m^3].
    inside: candidates in the box, (n,).
    """
    if not len(found):
        return np.zeros(0)
    blocks = list(_neighbours(_points_of(peaks, found)))
    probability = 1.0 / np.bincount(found.peaks, minlength=len(peaks))[found.peaks]
    update = _Update(peaks, found, volume_m3, inside)
    for _ in range(_ROUNDS):
        probability = update.shares(probability, *_support(blocks, probability))
    return probability


class _Update:
    """Update of candidates' probabilities by their support."""

    def __init__(self, peaks: PeakSet, found: Candidates, volume_m3: float, inside: Bools) -> None:
        self._n_peaks, self._peak_of = len(peaks), found.peaks
        self._prior = _log_prior(peaks, found.peaks, inside) + np.log(found.presence)
        self._direct_peaks = np.unique(found.peaks[inside & ~found.is_alias])
        self._extent = volume_m3 * np.pi  # solid angle of a hemisphere, projected

    def shares(self, probability: Floats, own: Floats, other: Floats) -> Floats:
        """Update probabilities by the densities that neighbours predict, (n,)."""
        explained = np.bincount(self._peak_of, probability, self._n_peaks)[self._direct_peaks]
        n_clutter = (1.0 - explained).sum() + _FLOOR * max(len(self._direct_peaks), 1)
        cell = self._extent / n_clutter  # volume and solid angle per clutter peak [m^3 sr]
        odds = (
            np.exp(self._prior)
            * (_ALONE + cell * own)
            * (1.0 + cell * other / _OTHER_SCALE) ** _OTHER_POWER
            / (cell * _peak_density()) ** _SHARED
        )
        return np.asarray(
            odds / (1.0 + np.bincount(self._peak_of, odds, self._n_peaks))[self._peak_of]
        )


def _peak_density() -> float:
    """Density that a point predicts at its own place [1 / (m^3 sr)]."""
    offset2, turn2 = 2.0 * _PEAK_M**2, 2.0 * _TURN_RAD**2
    scale = np.sqrt(2.0 * np.pi * offset2) * (2.0 * np.pi * turn2) * 2.0 * np.pi * _SPREAD_M**2
    return float(1.0 / scale)


def _points_of(peaks: PeakSet, found: Candidates) -> PeakPoints:
    subapertures = peaks.subapertures[found.peaks]
    planes = peaks.subaperture_planes[subapertures]
    return PeakPoints(found.positions, found.normals, planes, subapertures)


def _support(blocks: Iterable[sparse.csr_array], probability: Floats) -> tuple[Floats, Floats]:
    """Support of each point by probable neighbours, of its plane and of others, (n_points,) each.

    blocks: of `_neighbours`. probability: of the neighbours, (n_others,).
    """
    of_kinds = np.kron(np.eye(2), probability[:, None]).astype(np.float32)
    other, own = np.concatenate([block @ of_kinds for block in blocks]).T
    return own, other


def _neighbours(points: PeakPoints) -> Iterator[sparse.csr_array]:
    """Densities of pairs by blocks of points, in single precision: there may be two million.

    Peaks of one sub-aperture do not support each other: it has one return of a smooth surface.
    """
    model = PairModel(
        reach=_REACH_M,
        least_cosine=_ALIKE,
        spread=_SPREAD_M,
        offset_variance=2.0 * _PEAK_M**2,
        bend=ECHO_NOISE.bend_per_m2,
        turn_variance=2.0 * _TURN_RAD**2,
        curvature=ECHO_NOISE.curvature_per_m,
        least_density=_NEGLIGIBLE * _peak_density(),
    )
    for first in range(0, len(points.planes), _POINTS_AT_ONCE):
        densities = pair_densities(points.rows(first, first + _POINTS_AT_ONCE), points, model)
        yield densities.astype(np.float32)


def _log_prior(peaks: PeakSet, of: Ints, inside: Bools) -> Floats:
    """Prior log odds of each candidate by strength and noise, (n,)."""
    strength_db = 20.0 * np.log10(peaks.magnitudes[of])
    strong_db = np.quantile(strength_db[inside], 0.98) if inside.any() else strength_db.max()
    strength_db = np.minimum(strength_db - strong_db, 0.0)
    margin_db = np.minimum(peaks.margins_db[of], _MAX_MARGIN_DB)
    return np.asarray(_LOG_ODDS + _PER_STRENGTH_DB * strength_db + _PER_MARGIN_DB * margin_db)
