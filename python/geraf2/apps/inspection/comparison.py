"""What changed between two scans of one packed box: appeared, vanished, moved, swapped."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from scipy.special import expit, ndtr

from geraf2 import __version__
from geraf2._types import Bools, Floats, Ints
from geraf2.apps.inspection.bodies import Body
from geraf2.apps.inspection.coherent_change import Spots
from geraf2.apps.inspection.material import UNKNOWN, Material
from geraf2.apps.inspection.models import diagonal_m
from geraf2.apps.inspection.scan_evidence import (
    Evidence,
    Shift,
    cells_of,
    find_missed,
    join_cells,
    owners_of,
    shifts_of,
)
from geraf2.geometry.components import connected_labels
from geraf2.geometry.transforms import apply_rigid, inverse_rigid, rigid, triple
from geraf2.io.text import NOT_DETERMINED, interval_text
from geraf2.io.verdict import Verdict, confidence, not_determined

_N_STEPS, _STEP = 6, 1e-4
"""Steps of the registration; it ends at a step of this size [m], [rad]."""
_MIN_SHARE = 0.7
"""Least share of glints without a counterpart in a group that shows a change."""
_MIN_GLINTS = 3
"""Fewest glints of such a group."""
_GROUP_M = 0.010
"""Radius of a group of glints of one plane [m]."""
_PRIOR_ODDS, _PLANE_ODDS = 0.01, 33.0
"""Odds of a change of a part before it is looked at, and factor of each plane that misses a group:
1.5 % of the groups of unchanged parts are missed, and half of those of changed ones."""
_MOVED_LOG_ODDS = 0.0
"""Log odds that a part moved, before its shift is measured."""
_SAME_POSITION_M = 0.04
"""Distance within which groups show one change: the length of a part [m]."""
_SAME_CHANGE_M = 0.01
"""Distance within which the changes against two references are the same [m]."""
_CERTAIN = 0.85
"""Least probability of a change that is reported."""

What = Literal["appeared", "vanished", "moved", "swapped"]


@dataclass(frozen=True, kw_only=True)
class Change:
    """Something that is not as it was."""

    what: What
    """`appeared`, `vanished`, `moved`, or `swapped` for another part."""
    is_body: bool
    """A whole part; else surface of a part that stayed."""
    center_m: tuple[float, float, float]
    """Its middle, in the frame of the run [m]."""
    size_m: float
    """How far it moved, or its length [m]."""
    sigma_m: float
    """Standard uncertainty of that [m]."""
    probability: float
    """That it changed by more than the tolerance, 0 to 1."""

    @property
    def size_text(self) -> str:
        """How far it moved, or its length, with its interval [mm]."""
        return interval_text(1e3 * self.size_m, 1.96e3 * self.sigma_m)

    def __str__(self) -> str:
        """Return the change in words."""
        at = ", ".join(f"{1e3 * x:z.0f}" for x in self.center_m)
        kind = "a part" if self.is_body else "surface"
        size = f"{self.size_text} mm" if self.size_text != NOT_DETERMINED else "an unknown length"
        by = f"by {size}" if self.what == "moved" else f"{size} long"
        return f"{kind} {self.what}, {by}, at ({at}) mm, {100 * self.probability:.1f} %"


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Differences of a run from reference runs of the same packed box."""

    changes: tuple[Change, ...]
    """Found against every reference, the likeliest first."""
    n_parts: tuple[int, ...]
    """Number of parts of the run, and of each reference."""
    shift_m: tuple[float, float, float]
    """By how much the content lies elsewhere than in the first reference, both in their frames, at
    the middle of the content [m]."""
    turn_deg: float
    """And by how much it is turned [degrees]."""
    compared_fraction: float
    """Least share of the run's glints that the planes of a reference should see, 0 to 1."""
    tolerance_m: float
    """Largest change that is none [m]."""
    verdict: Verdict | None = None
    """How far the runs can be trusted together; None where none was judged."""

    @property
    def changed(self) -> bool | None:
        """Whether anything changed; None where a run is not to be trusted."""
        return None if not_determined(self.verdict) else bool(self.changes)

    @property
    def answer(self) -> str:
        """`changed`, `unchanged`, or why that is not determined."""
        word = not_determined(self.verdict) or ("changed" if self.changed else "unchanged")
        return word + (self.verdict.condition if self.verdict else "")

    def weighed(self) -> "Comparison":
        """Weigh the changes by the probability that the runs are right.

        There are none of runs that are not to be trusted.
        """
        share = confidence(self.verdict)
        changes = [replace(c, probability=share * c.probability) for c in self.changes if share]
        return replace(self, changes=tuple(changes))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, SI units."""
        known = asdict(replace(self, verdict=None))
        if self.changed is None:
            known |= {"changes": None, "not_determined": self.verdict and self.verdict.reason}
        return {
            "format": "geraf2-comparison",
            "format_version": 1,
            "generator": f"geraf2 {__version__}",
            "changed": self.changed,
            **known,
            "verdict": self.verdict and self.verdict.numbers(),
        }


class Scanned(NamedTuple):
    """Content of one scan."""

    whole: Body
    bodies: Sequence[Body]
    evidence: Evidence
    materials: Sequence[Material]

    def move(self, pose: Floats) -> "Scanned":
        """Its parts in another frame; the evidence stays in its own."""
        bodies = [_move_body(body, pose) for body in self.bodies]
        return self._replace(whole=_move_body(self.whole, pose), bodies=bodies)


class Play(NamedTuple):
    """How far the content may lie beside its pose by the walls, standard deviations."""

    turn_rad: float
    shift_m: float


def register_scans(
    here: Scanned, there: Scanned, start: Floats, play: Play
) -> tuple[Floats, Sequence[Body], dict[int, Shift]]:
    """Pose that moves one scan onto another, (4, 4), and the parts that do not follow it.

    start: pose by the walls. Returns pose, parts in the frame of the other scan, and the shift of
    those that moved by themselves, from here to there.
    """
    middle, beside, pose = (
        apply_rigid(start, here.whole.mesh.vertices).mean(axis=0),
        np.zeros(6),
        start,
    )
    parts, found = there.bodies, dict[int, Shift]()
    for _ in range(_N_STEPS):
        if len(here.bodies) > len(there.bodies):
            parts = [_move_body(body, pose) for body in here.bodies]
        back = inverse_rigid(pose[:3, :3], pose[:3, 3])
        cells = join_cells(
            cells_of(here.evidence, there.evidence, pose, parts),
            cells_of(
                there.evidence, here.evidence, back, [_move_body(part, back) for part in parts]
            ),
            pose,
        )
        turn, shift, found = shifts_of(cells, len(parts), middle, play, beside)
        step = np.concatenate([turn, shift]) - beside
        beside = beside + step
        rotation = Rotation.from_rotvec(turn).as_matrix()
        pose = rigid(rotation, middle + shift - rotation @ middle) @ start
        if np.abs(step).max() < _STEP:
            break
    return pose, parts, found


def compare_scans(
    here: Scanned,
    there: Scanned,
    start: Floats,
    play: Play,
    tolerance_m: float,
    spots: Spots | None = None,
) -> tuple[list[Change], Floats, float]:
    """Find what changed from an earlier scan.

    start: moves the run into the frame of the earlier scan by its walls, (4, 4). tolerance_m: least
    shift that counts [m]. spots: echoes compared in phase. Returns changes, pose, and share of
    the glints that both scans could see.
    """
    pose, parts, shifts = register_scans(here, there, start, play)
    back = inverse_rigid(pose[:3, :3], pose[:3, 3])
    new, share = _missed_groups(here, there, pose, "appeared")
    gone, _ = _missed_groups(there, here, back, "vanished")
    gone = [
        g._replace(points=apply_rigid(back, g.points), body=_move_body(g.body, back)) for g in gone
    ]
    changes = [*_material_changes(here, there, pose), *_group_changes([*new, *gone])]
    changes = [c for c in changes if c.probability >= _CERTAIN]
    for part, shift in shifts.items():
        body = _move_body(parts[part], back)
        if len(here.bodies) <= len(there.bodies):  # the part is where it was
            body = _move_body(body, rigid(np.eye(3), -back[:3, :3] @ shift.shift_m))
        moved = _shift_change(body, shift, tolerance_m)
        if moved.probability >= _CERTAIN and all(
            _distance(c, moved) >= _SAME_POSITION_M for c in changes
        ):
            changes.append(moved)
    others = [] if spots is None else _spot_changes(spots, here)
    changes += [c for c in others if all(_distance(c, o) >= _SAME_POSITION_M for o in changes)]
    return changes, pose, share


class _Group(NamedTuple):
    """Glints of one plane and part that the other scan should have seen, and did not."""

    what: What
    plane: int
    points: Floats
    """(n, 3) [m]."""
    body: Body
    """Part that they are on."""
    is_body: bool
    """Whether most of the part was not seen again."""


def _missed_groups(
    one: Scanned, other: Scanned, pose: Floats, what: What
) -> tuple[list[_Group], float]:
    """Find groups of one scan that another one did not see, in the frame of the first."""
    # Also returns the share of the glints that the other scan should see.
    visible, missed = find_missed(one.evidence, other.evidence, pose)
    glints, found = one.evidence.glints, list[_Group]()
    owner = owners_of(glints.positions, one.bodies)
    for part, body in enumerate(one.bodies):
        own = visible & (owner == part)
        is_body = bool(own.any() and missed[own].mean() > 0.5)
        for plane in np.unique(glints.poses[own]):
            group = _missed_group(glints.positions, own & (glints.poses == plane), missed)
            if len(group):
                points = glints.positions[group]
                found.append(_Group(what, int(plane), points, body, is_body))
    return found, float(visible.mean()) if len(visible) else 0.0


def _group_changes(groups: Sequence[_Group]) -> list[Change]:
    """Join neighbouring groups to changes."""
    # What vanished and appeared in one position is swapped.
    if not groups:
        return []
    middles = np.array([group.points.mean(axis=0) for group in groups])
    i, j = KDTree(middles).query_pairs(_SAME_POSITION_M, output_type="ndarray").reshape(-1, 2).T
    labels = connected_labels(i, j, len(groups))
    changes = []
    for label in np.unique(labels):
        own = [group for group, of in zip(groups, labels, strict=True) if of == label]
        # The planes of both scans are independent, and those of one see other sides of the part.
        odds = _PRIOR_ODDS * _PLANE_ODDS ** len({(group.what, group.plane) for group in own})
        kinds = {group.what for group in own}
        whole = next((group.body for group in own if group.is_body), None)
        points = np.concatenate([group.points for group in own])
        changes.append(
            Change(
                what=own[0].what if len(kinds) == 1 else "swapped",
                is_body=whole is not None,
                center_m=triple(middle_of(whole) if whole else points.mean(axis=0)),
                size_m=diagonal_m(whole.mesh.vertices if whole else points),
                sigma_m=float(np.median(own[0].body.sigma_m)),
                probability=odds / (1.0 + odds),
            )
        )
    return changes


def _spot_changes(spots: Spots, here: Scanned) -> list[Change]:
    """Join neighbouring positions whose echo has likelier changed than not."""
    prior = _PRIOR_ODDS * len(here.bodies) / max(len(spots.points), 1)
    log_odds = np.log(prior) + spots.log_ratios
    at = np.flatnonzero(log_odds > 0.0)
    if not len(at):
        return []
    points, changes = spots.points[at], list[Change]()
    i, j = KDTree(points).query_pairs(_SAME_POSITION_M, output_type="ndarray").reshape(-1, 2).T
    labels = connected_labels(i, j, len(points))
    for label in np.unique(labels):
        own = at[labels == label]
        best = own[np.argmax(log_odds[own])]
        change = Change(
            what="appeared" if spots.gains[own].sum() > 0.0 else "vanished",
            is_body=False,
            center_m=triple(spots.points[best]),
            size_m=diagonal_m(spots.points[own]),
            sigma_m=float(np.median(here.whole.sigma_m)),
            probability=float(expit(np.logaddexp.reduce(log_odds[own]))),
        )
        changes.append(change)
    return [change for change in changes if change.probability >= _CERTAIN]


def _missed_group(positions: Floats, own: Bools, missed: Bools) -> Ints:
    """Find the largest group of missed glints among own ones; empty if most are found."""
    at = np.flatnonzero(own)
    best = np.zeros(0, dtype=np.int64)
    for near in KDTree(positions[at]).query_ball_point(positions[at], _GROUP_M):
        gone = at[near][missed[at[near]]]
        if len(gone) >= max(_MIN_GLINTS, _MIN_SHARE * len(near), len(best) + 1):
            best = gone
    return best


def _material_changes(here: Scanned, there: Scanned, pose: Floats) -> list[Change]:
    """Parts whose material is another one, for certain in both scans."""
    changes = []
    for body, material in zip(here.bodies, here.materials, strict=True):
        for other, former in zip(there.bodies, there.materials, strict=True):
            gap = np.linalg.norm(apply_rigid(pose, middle_of(body)) - middle_of(other))
            kinds = {material.kind, former.kind}
            if gap > _GROUP_M or len(kinds) == 1 or UNKNOWN.kind in kinds:
                continue
            metal = sorted((material.metal_probability, former.metal_probability))
            changes.append(
                Change(
                    what="swapped",
                    is_body=True,
                    center_m=triple(middle_of(body)),
                    size_m=diagonal_m(body.mesh.vertices),
                    sigma_m=float(np.median(body.sigma_m)),
                    probability=metal[1] * (1.0 - metal[0]),
                )
            )
    return changes


def _shift_change(body: Body, shift: Shift, tolerance_m: float) -> Change:
    """Change of a part that moved by itself."""
    size = float(np.linalg.norm(shift.shift_m))
    along = shift.shift_m / max(size, 1e-9)
    sigma = float(np.sqrt(along @ shift.covariance @ along))
    is_moved = expit(shift.log_odds + _MOVED_LOG_ODDS)
    # The shift exceeds what it is in any direction: here the one that is known best.
    known = np.linalg.solve(shift.covariance, shift.shift_m)
    known /= max(float(np.linalg.norm(known)), 1e-30)
    beyond = (known @ shift.shift_m - tolerance_m) / np.sqrt(known @ shift.covariance @ known)
    return Change(
        what="moved",
        is_body=True,
        center_m=triple(middle_of(body)),
        size_m=size,
        sigma_m=sigma,
        probability=float(is_moved * ndtr(beyond)),
    )


def common_changes(found: Sequence[Sequence[Change]]) -> tuple[Change, ...]:
    """Return the changes against every reference, with the least of their probabilities."""
    kept = []
    for change in found[0]:
        alike = [
            [c for c in others if c.what == change.what and _distance(c, change) < _SAME_CHANGE_M]
            for others in found[1:]
        ]
        if all(alike):
            likely = [max(c.probability for c in some) for some in alike]
            kept.append(replace(change, probability=min([change.probability, *likely])))
    return tuple(sorted(kept, key=lambda change: -change.probability))


def _move_body(body: Body, pose: Floats) -> Body:
    return replace(body, mesh=body.mesh.moved(pose))


def middle_of(body: Body) -> Floats:
    """Middle of the box around a part, (3,) [m]."""
    return np.asarray(0.5 * (body.mesh.vertices.min(axis=0) + body.mesh.vertices.max(axis=0)))


def _distance(one: Change, other: Change) -> float:
    return float(np.linalg.norm(np.subtract(one.center_m, other.center_m)))
