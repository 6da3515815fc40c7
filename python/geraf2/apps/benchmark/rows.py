"""Rows of tables: scene, setting and method, with their results."""

from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import product

from geraf2.apps.benchmark.suite import Case, Method, Suite
from geraf2.errors import UserError
from geraf2.pipeline.presets import PresetConfig, versions_of
from geraf2.simulation import SceneSpec


@dataclass(frozen=True, kw_only=True)
class Row:
    """A scene in a case, reconstructed by a method."""

    experiment: str
    """Name of the table."""
    scene: str
    """Name of the scene."""
    case: Case
    """Setting."""
    method: str
    """Name of the method."""
    spec: SceneSpec
    """Spec of the simulated scene."""
    config: PresetConfig
    """Preset and its constants."""
    how: Method
    """The method."""
    seed: int | None = None
    """Of scene, reconstruction and samples; that of the runner when None."""

    @property
    def name(self) -> str:
        """For messages."""
        parts = [self.experiment, self.scene, self.case.label, self.method]
        return " / ".join(part for part in parts if part)

    @property
    def versions(self) -> dict[str, int]:
        """Versions of the stages that the row depends on."""
        return versions_of(self.config)


@dataclass(frozen=True, kw_only=True)
class RowResult:
    """Scores of a row, or its error."""

    f1_15mm: float | None = None
    """F1 at 15 mm."""
    f1_5mm: float | None = None
    """F1 at 5 mm."""
    f1_3mm: float | None = None
    """F1 at 3 mm."""
    f1_2mm: float | None = None
    """F1 at 2 mm."""
    chamfer_1e3_m2: float | None = None
    """Chamfer distance [1e-3 m^2]."""
    volume_ratio: float | None = None
    """Volume over the true one."""
    extent_x_m: float | None = None
    """Extent along x less the true one [m]."""
    extent_y_m: float | None = None
    """The same along y [m]."""
    extent_z_m: float | None = None
    """The same along z [m]."""
    offset_m: float | None = None
    """Median offset of the surface along the normal, positive outside [m]."""
    median_m: float | None = None
    """Median distance in both directions [m]."""
    expected_m: float | None = None
    """Median over the area of the surface's own expected error [m]."""
    same_topology: float | None = None
    """1 where the mesh has the truth's numbers of pieces and holes, else 0."""
    topology: str | None = None
    """Pieces and holes of the mesh, and those of the truth in brackets."""
    cpu_seconds: float | None = None
    """Processor time of the reconstruction [s]."""
    all_cpu_seconds: float | None = None
    """Processor time of the row with its evaluation, without its scene [s]."""
    scores: dict[str, float] | None = None
    """Scores of the population's table, by name."""
    error: str | None = None
    """Reason of a failure, one line."""
    folder: str | None = None
    """Run folder, relative to the benchmark's."""
    scene_folder: str | None = None
    """Scene folder, relative to the benchmark's."""

    @property
    def extent_m(self) -> float | None:
        """Largest absolute error of the three extents [m]."""
        errors = self.extent_x_m, self.extent_y_m, self.extent_z_m
        known = [abs(error) for error in errors if error is not None]
        return max(known) if known else None

    def __str__(self) -> str:
        if self.error is not None:
            return f"failed: {self.error}"
        return "" if self.f1_5mm is None else f"F1 5 mm {self.f1_5mm:.3f}"


def rows_of(
    suite: Suite, only: tuple[str, ...] = (), choice: Mapping[str, tuple[str, ...]] | None = None
) -> list[Row]:
    """List the selected rows in the order of the tables; UserError for a pattern without a match.

    only: names of experiments; empty: all but those that run by name only.
    choice: patterns of the names of "scene", "case" and "method", of each of which one must match;
        `*` matches any letters, `?` one; none are as if all matched.
    """
    in_form = " in --quick" if suite.is_quick else ""
    unknown = [name for name in only if name not in suite.experiments]
    if unknown:
        raise UserError(
            what="no such experiment" + in_form,
            expected="some of " + ", ".join(suite.experiments),
            got=", ".join(unknown),
        )
    rows = [
        Row(
            experiment=name,
            scene=scene,
            case=case,
            method=method,
            spec=suite.spec(scene, case),
            config=suite.config(method, case),
            how=suite.methods[method],
        )
        for name, experiment in suite.experiments.items()
        if name in only or not (only or experiment.by_name)
        for scene, case, method in product(experiment.scenes, experiment.cases, experiment.methods)
    ]
    names = {
        "scene": [row.scene for row in rows],
        "case": [row.case.label for row in rows],
        "method": [row.method for row in rows],
    }
    left = list(range(len(rows)))
    for what, patterns in (choice or {}).items():
        known = [name for name in dict.fromkeys(names[what]) if name]
        unknown = [p for p in patterns if not any(fnmatchcase(name, p) for name in known)]
        if unknown:
            raise UserError(
                what=f"no such {what}{in_form}",
                expected="some of " + "; ".join(known) if known else f"none: no {what} has a name",
                got="; ".join(unknown),
            )
        if patterns:
            left = [n for n in left if any(fnmatchcase(names[what][n], p) for p in patterns)]
    if choice is not None and not left:
        raise UserError(what="no row matches scene, case and method together" + in_form)
    return [rows[number] for number in left]
