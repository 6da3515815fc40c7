"""Result of an inspection, as Python objects, JSON, CSV and sentences."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations, repeat
from typing import Any

import numpy as np

from geraf2 import __version__
from geraf2._short import Short
from geraf2._types import AnyPath, Floats
from geraf2.apps.inspection.bodies import BodyReport, position_text
from geraf2.apps.inspection.deviation import Deviation, list_regions
from geraf2.apps.inspection.expected import swap_text
from geraf2.apps.inspection.matching import Match
from geraf2.apps.inspection.models import CadModel
from geraf2.echoes.ruled_out import Region
from geraf2.geometry.transforms import apply_rigid
from geraf2.geometry.triangles import volume_centroid_m
from geraf2.io.atomic import write_json_atomic, write_text_atomic
from geraf2.io.text import NOT_DETERMINED, csv_text
from geraf2.io.verdict import Verdict, confidence, not_determined

PASS, FAIL, NOT_JUDGED = "pass", "fail", "not judged"
# What a model that is not as it should be is.
_FAULTS = {
    "wrong part": "is there as other parts",
    "turned": "is turned against its nominal pose",
    "moved": "lies away from its nominal pose",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelReport:
    """One model: its pose, and the deviation of the part from it."""

    model: CadModel
    """The model."""
    match: Match
    """Part and pose."""
    deviation: Deviation | None
    """Deviation of the part from the model; None: missing, or another part."""

    @property
    def nominal_center_m(self) -> Floats:
        """Centroid of the model's volume in its own frame, (3,) [m]."""
        return volume_centroid_m(self.model.mesh.vertices, self.model.mesh.faces)

    @property
    def center_m(self) -> Floats:
        """Centroid of the placed model's volume, in the capture's frame, (3,) [m]."""
        assert self.match.placement is not None  # of a missing model nothing is stated
        return apply_rigid(self.match.placement.pose, self.nominal_center_m)

    @property
    def center_sigma_m(self) -> Floats:
        """Standard uncertainty of that, per coordinate, (3,) [m]."""
        assert self.match.placement is not None  # as above
        return np.sqrt(np.diag(self.match.placement.covariances_at(self.center_m[None])[0]))

    @property
    def center_text(self) -> str:
        """Centre with its interval [mm]."""
        return position_text(self.center_m, self.center_sigma_m, max(self.model.lengths_m))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Inspection(Short):
    """Result of `geraf2.inspect`."""

    parts: tuple[BodyReport, ...]
    """Parts of the content, the largest first."""
    models: tuple[ModelReport, ...]
    """Report of each model."""
    failures: tuple[str, ...]
    """Reasons of a failure, a sentence each; empty: pass."""
    notes: tuple[str, ...]
    """Warnings for the user."""
    tolerance_m: float
    """Largest deviation allowed [m]."""
    scene: tuple[str, str]
    """Name and digest of the scene."""
    has_criteria: bool = True
    """Whether anything was required: models, or a number of parts."""
    verdict: Verdict | None = None
    """How far the scan can be trusted; None where it was not judged."""
    ruled_out: tuple[Region, ...] = ()
    """Smallest bodies that would have been found, by part of the box; empty where unknown."""

    @property
    def result(self) -> str:
        """`pass`, `fail`, `not judged` where nothing was required, or `not determined`.

        Nothing is determined of a scan that is not to be trusted.
        """
        if not self.has_criteria:
            return NOT_JUDGED
        if not_determined(self.verdict):
            return NOT_DETERMINED
        return FAIL if self.failures else PASS

    @property
    def intervals(self) -> str:
        """What the values after ± mean, or why there are none."""
        return not_determined(self.verdict) or f"± holds {95.0 * confidence(self.verdict):.0f} %"

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, SI units; null where nothing is determined."""
        is_withdrawn = bool(not_determined(self.verdict))
        return {
            "format": "geraf2-inspection",
            "format_version": 1,
            "generator": f"geraf2 {__version__}",
            "scene": dict(zip(("name", "digest"), self.scene, strict=True)),
            "result": self.result,
            "verdict": self.verdict and self.verdict.numbers(),
            **({"not_determined": self.verdict.reason} if is_withdrawn and self.verdict else {}),
            "failures": list(self.failures),
            "notes": list(self.notes),
            "uncertainty": "sigma is one standard deviation; 95 % of errors are below 1.96 of it",
            "tolerance_m": self.tolerance_m,
            "ruled_out": [asdict(region) for region in self.ruled_out],
            "parts": [asdict(part) for part in self.parts],
            "models": [_model(report) for report in self.models],
        }

    def write(self, stem: AnyPath) -> None:
        """Write `<stem>.json` and `<stem>.csv`."""
        write_json_atomic(f"{stem}.json", self.to_dict())
        write_text_atomic(f"{stem}.csv", self.to_csv())

    def to_csv(self) -> str:
        """Rows of quantities of each part, then of each model: millimetres, degrees, fractions."""
        lines: list[tuple[Any, ...]] = []
        for number, part in enumerate(self.parts, 1):
            lines += [("part", number, "found", *row) for row in _part_rows(part)]
        for report in self.models:
            name, status = report.model.name, report.match.status
            lines += [("model", name, status, *row) for row in _model_rows(report)]
        if self.verdict is not None:
            failure = f"{self.verdict.probability_of_failure:.4f}"
            lines.append(
                ("verdict", "", self.verdict.trust, "probability of failure", failure, "", "")
            )
        lines.append(("result", "", self.result, "failures", len(self.failures), "", ""))
        return csv_text(("kind", "name", "status", "quantity", "value", "sigma", "unit"), lines)


def rotation_vector_deg(pose: Any) -> Any:
    """Rotation of a pose as axis times angle, (3,) [degrees]."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - takes 0.1 s

    return np.rad2deg(Rotation.from_matrix(pose[:3, :3]).as_rotvec())


def _axis_rows(
    name: str, values: Iterable[float], sigmas: Iterable[float | None], scale: float, unit: str
) -> list[tuple[str, str, str, str]]:
    """Rows of a vector with its standard uncertainties."""
    return [
        (f"{name} {axis}", f"{scale * value:z.3f}", _scaled(sigma, scale, 3), unit)
        for axis, value, sigma in zip("xyz", values, sigmas, strict=False)
    ]


def _scaled(value: float | None, scale: float, digits: int) -> str:
    """Value in another unit; empty where there is none."""
    return "" if value is None else f"{scale * value:.{digits}f}"


def _part_rows(part: BodyReport) -> list[tuple[str, str, str, str]]:
    sigmas = part.center_sigma_m or repeat(None)
    rows = _axis_rows("center", part.center_m, sigmas, 1e3, "mm")
    rows += [
        (f"length along {axis}", f"{1e3 * side:.3f}", "", "mm")
        for axis, side in zip("xyz", part.extents_m, strict=True)
    ]
    rows += [
        (f"length {n}", f"{1e3 * m.value:.3f}", _scaled(m.sigma, 1e3, 3), "mm")
        for n, m in enumerate(part.dimensions_m, 1)
    ]
    volume, area = part.volume_m3, part.area_m2
    rows.append(("volume", f"{1e9 * volume.value:.0f}", _scaled(volume.sigma, 1e9, 0), "mm3"))
    rows.append(("area", f"{1e6 * area.value:.0f}", _scaled(area.sigma, 1e6, 0), "mm2"))
    material, level = part.material, part.material.reflectivity_db
    rows.append(("probability of metal", f"{material.metal_probability:.4f}", "", ""))
    if level is not None:
        rows.append(("reflectivity", f"{level.value:.2f}", _scaled(level.sigma, 1.0, 2), "dB"))
    if material.permittivity is not None:
        known = material.permittivity
        rows.append(("permittivity", f"{known.value:.3f}", _scaled(known.sigma, 1.0, 3), ""))
    for name, t in zip(("least", "largest"), material.thickness_m or (), strict=False):
        rows.append((f"{name} thickness", f"{1e3 * t:.3f}", "", "mm"))
    rows.append(("probability", _scaled(part.probability, 1.0, 4), "", ""))
    return [*rows, ("seen fraction", f"{part.seen_fraction:.4f}", "", "")]


def _model_rows(report: ModelReport) -> list[tuple[str, str, str, str]]:
    rows = [
        (f"length {n} of the CAD model", f"{1e3 * side:.3f}", "", "mm")
        for n, side in enumerate(report.model.lengths_m, 1)
    ]
    placement, deviation = report.match.placement, report.deviation
    if placement is not None:
        rows.append(("misfit", f"{placement.misfit:.4f}", "", ""))
        rows.append(("largest misfit", f"{report.match.largest_misfit:.4f}", "", ""))
        rows += _axis_rows("center", report.center_m, report.center_sigma_m, 1e3, "mm")
        turn, sigmas = rotation_vector_deg(placement.pose), np.rad2deg(placement.rotation_sigma_rad)
        rows += _axis_rows("turn", turn, sigmas, 1.0, "degrees")
        if placement.explained is not None:
            rows.append(("explained echoes", f"{placement.explained:.4f}", "", ""))
    if deviation is not None:
        rows.append(("rms deviation", f"{1e3 * deviation.rms_m:.3f}", "", "mm"))
        rows.append(("within tolerance", f"{deviation.within_fraction:.4f}", "", ""))
        rows.append(("seen fraction of the model", f"{deviation.seen_fraction:.4f}", "", ""))
        rows += [
            (r.what, f"{1e3 * r.deviation_m:z.3f}", f"{1e3 * r.sigma_m:.3f}", "mm")
            for r in deviation.regions
        ]
    return rows


def _model(report: ModelReport) -> dict[str, Any]:
    match, placement, deviation = report.match, report.match.placement, report.deviation
    made: dict[str, Any] = {
        "name": report.model.name,
        "unit": report.model.unit,
        "status": match.status,
        "lengths_m": list(report.model.lengths_m),
        "part": None if match.body is None else match.body + 1,
    }
    if placement is not None:
        made |= {
            "pose": placement.pose.tolist(),
            "center_m": report.center_m.tolist(),
            "center_sigma_m": report.center_sigma_m.tolist(),
            "rotation_sigma_rad": placement.rotation_sigma_rad.tolist(),
            "misfit": placement.misfit,
            "largest_misfit": match.largest_misfit,
            "rival_misfit": placement.rival_misfit,
            "free_axis": placement.free_axis,
            "explained": placement.explained,
        }
    if deviation is not None:
        made |= {
            "rms_deviation_m": deviation.rms_m,
            "within_fraction": deviation.within_fraction,
            "seen_fraction": deviation.seen_fraction,
            "regions": [asdict(region) for region in deviation.regions],
        }
    return made


def failures_of(
    parts: Sequence[BodyReport],
    models: Sequence[ModelReport],
    *,
    expect: int | None,
    min_seen: float,
) -> list[str]:
    """Reasons why an inspection fails, a sentence each; not those of missing models."""
    found: list[str] = []
    if expect is not None and len(parts) != expect:
        here = "1 part was" if len(parts) == 1 else f"{len(parts)} parts were"
        found.append(f"{here} found, {expect} {'was' if expect == 1 else 'were'} expected")
    names, swaps = [report.model.name for report in models], _find_exchanged(models)
    found += [f"'{names[a]}' and '{names[b]}' are swapped" for a, b in swaps]
    exchanged = {n for pair in swaps for n in pair}
    for n, report in enumerate(models):
        name, status, body = f"'{report.model.name}'", report.match.status, report.match.body
        if status == "wrong part" and body is not None and body >= 0:
            found.append(f"{name} is {swap_text(body, parts)}")
        elif status in _FAULTS and n not in exchanged:
            found.append(f"{name} {_FAULTS[status]}")
        if report.deviation is None:
            continue
        if report.deviation.regions:
            found.append(f"{name} is out of tolerance: {list_regions(report.deviation.regions)}")
        if report.deviation.seen_fraction < min_seen:
            found.append(
                f"only {100 * report.deviation.seen_fraction:.0f} % of {name} was seen, "
                f"{100 * min_seen:.0f} % are required"
            )
    return found


def _find_exchanged(models: Sequence[ModelReport]) -> list[tuple[int, int]]:
    """Pairs of models each of which lies where the other one should."""
    off = [n for n, report in enumerate(models) if report.match.status in ("turned", "moved")]
    here = {n: models[n].center_m for n in off}
    nominal = {n: models[n].nominal_center_m for n in off}

    def is_nearer(a: int, b: int) -> bool:
        """Whether a lies at the nominal pose of b rather than at its own."""
        gaps = [float(np.linalg.norm(here[a] - nominal[n])) for n in (a, b)]
        return gaps[1] < 0.5 * gaps[0]

    return [(a, b) for a, b in combinations(off, 2) if is_nearer(a, b) and is_nearer(b, a)]
