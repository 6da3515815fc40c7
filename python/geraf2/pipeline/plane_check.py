"""Check that the planes of a scan agree, against rivals of the recorded geometry."""

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from geraf2._types import Floats
from geraf2.echoes.plane_agreement import (
    MIN_PLANES,
    PlaneAgreement,
    Rival,
    as_recorded_at,
    plane_agreement,
    strong_echoes,
    with_axes_reversed,
)
from geraf2.imaging.peaks import PeakSet
from geraf2.scene import Capture

SURE_SIGMAS, DOUBTFUL_SIGMAS = 2.5, 1.0
"""Standard errors by which a rival geometry is better where it replaces the recorded one, and where
it is a cause of a failure. Sound scans have at most 0."""
_ODD_SHARE = 0.5
"""A plane whose agreement is below this share of the median plane's is compared with others."""
_MAX_ODD = 8
"""Largest number of planes that are tried in each other's places."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlaneCheck:
    """Agreement of a scan's planes as recorded, and under rivals."""

    recorded: PlaneAgreement
    reversed_turn: Rival
    """Turntable in the other sense; or, seen in a mirror, reversed horizontal axes."""
    upside_down: Rival
    """Reversed vertical axes; the same as recorded where one ring is as high as its content."""
    exchanged: tuple[tuple[int, int], ...] = ()
    """Planes that agree better in each other's places."""

    def numbers(self) -> dict[str, Any]:
        """Entries of run.json."""
        return {
            "agreement": round(self.recorded.share, 3),
            "other_sense_agreement": round(self.reversed_turn.share, 3),
            "other_sense_sigmas": round(self.reversed_turn.sigmas, 1),
            "upside_down_sigmas": round(self.upside_down.sigmas, 1),
            "exchanged_planes": [list(pair) for pair in self.exchanged],
        }


def check_planes(capture: Capture, peaks: PeakSet) -> PlaneCheck:
    """Compare the planes of a capture. peaks: of all planes."""
    echoes = strong_echoes(peaks)
    recorded = plane_agreement(echoes, len(capture.poses))
    return PlaneCheck(
        recorded=recorded,
        reversed_turn=_reversed(capture, echoes, recorded, horizontal=True),
        upside_down=_reversed(capture, echoes, recorded, vertical=True),
        exchanged=_find_exchanged(capture, echoes, recorded.of_planes),
    )


def is_turn_reversed(capture: Capture, peaks: PeakSet) -> bool:
    """Whether the turntable of a capture surely ran in the other sense. peaks: of all planes."""
    echoes = strong_echoes(peaks)
    recorded = plane_agreement(echoes, len(capture.poses))
    sigmas = _reversed(capture, echoes, recorded, horizontal=True).sigmas
    is_sure = sigmas > SURE_SIGMAS
    return is_sure and sigmas > _reversed(capture, echoes, recorded, vertical=True).sigmas


def _reversed(capture: Capture, echoes: PeakSet, recorded: PlaneAgreement, **axes: bool) -> Rival:
    """Axes of all planes reversed, against the planes as recorded."""
    turned = with_axes_reversed(echoes, capture.poses, **axes)
    return Rival.of(recorded, plane_agreement(turned, len(capture.poses)))


def _find_exchanged(
    capture: Capture, echoes: PeakSet, shares: Floats
) -> tuple[tuple[int, int], ...]:
    """Pairs of planes that agree better in each other's places. shares: of each plane as it is."""
    known = np.isfinite(shares)
    if known.sum() < MIN_PLANES:
        return ()
    usual = _ODD_SHARE * float(np.nanmedian(shares))
    low = np.flatnonzero(known & (shares < usual))
    candidates = low[np.argsort(shares[low])][:_MAX_ODD]
    gains = list[tuple[float, int, int]]()
    for a, b in combinations(sorted(candidates.tolist()), 2):
        moved = as_recorded_at(echoes, capture.poses, {a: b, b: a})
        there = plane_agreement(moved, len(capture.poses)).of_planes
        gains.append((float((there - shares)[[a, b]].min()), a, b))
    left, pairs = set(candidates.tolist()), list[tuple[int, int]]()
    for gain, a, b in sorted(gains, reverse=True):
        if {a, b} <= left and gain > max(0.0, usual - max(shares[a], shares[b])):
            pairs.append((a, b))
            left -= {a, b}
    return tuple(sorted(pairs))
