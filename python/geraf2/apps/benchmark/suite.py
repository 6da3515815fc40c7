"""Suites of a benchmark: scenes, methods and experiments, from one TOML file."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

from geraf2.errors import UserError
from geraf2.io.toml import from_table, merge_tables, read_toml
from geraf2.pipeline.presets import PresetConfig, preset_of_table
from geraf2.pipeline.run_record import RunOptions
from geraf2.simulation import SceneSpec, parse_spec

OWN_SUITE = "benchmark.toml"
"""Default suite, part of the package."""


@dataclass(frozen=True, kw_only=True)
class Method:
    """One method of reconstruction."""

    title: str
    """Name in tables."""
    preset: str = "fast"
    """Preset of the reconstruction."""
    settings: dict[str, Any] = field(default_factory=dict)
    """Changes of the preset's constants, as nested tables."""
    quick: dict[str, Any] = field(default_factory=dict)
    """Further changes with --quick."""
    kind: Literal["reconstruct", "oracle", "population"] = "reconstruct"
    """"population": scores of the population's table. "oracle": matched filter, best threshold."""
    options: dict[str, Any] = field(default_factory=dict)
    """Options of the run beside the preset, see :class:`RunOptions`."""

    def run_options(self, seed: int) -> RunOptions:
        """Options of a run with this seed."""
        return from_table({"seed": seed, **self.options}, RunOptions, f"method {self.title}")


@dataclass(frozen=True, kw_only=True)
class Case:
    """One setting of an experiment."""

    label: str
    """Name in the table."""
    scene: dict[str, Any] = field(default_factory=dict)
    """Changes of the scene's spec, as nested tables."""
    settings: dict[str, Any] = field(default_factory=dict)
    """Changes of the method's constants, as nested tables."""
    prior_shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Displacement of the prior from the box [m]."""
    given_permittivity: float | Literal["true", "none"] = "true"
    """Permittivity of the walls recorded in the scene: the true one, another one, or no walls."""


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One table: each scene with each method in each case."""

    title: str
    """Heading."""
    scenes: tuple[str, ...]
    """Names of scenes."""
    methods: tuple[str, ...]
    """Names of methods."""
    cases: tuple[Case, ...] = (Case(label=""),)
    """Settings."""
    scene: dict[str, Any] = field(default_factory=dict)
    """Changes of all scenes' specs in all cases, as nested tables."""
    by_name: bool = False
    """Whether it runs only when selected by name."""
    note: str = ""
    """Remark for readers."""
    quick: bool = False
    """Whether --quick runs it, with the following selections."""
    quick_scenes: tuple[str, ...] = ()
    """Scenes of --quick; all when empty."""
    quick_methods: tuple[str, ...] = ()
    """Methods of --quick; all when empty."""
    quick_cases: tuple[str, ...] = ()
    """Labels of the cases of --quick; all when empty."""
    published: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)
    """Values of the paper on real data: scene, method, name of the score, value."""


@dataclass(frozen=True, kw_only=True)
class _File:
    """Contents of the TOML file."""

    scenes: dict[str, dict[str, Any]]
    methods: dict[str, Method]
    experiments: dict[str, Experiment]
    base: dict[str, Any] = field(default_factory=dict)
    """Common part of all scenes."""
    quick: dict[str, Any] = field(default_factory=dict)
    """Changes of all scenes with --quick."""


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Scenes, methods and experiments of a benchmark."""

    scenes: dict[str, dict[str, Any]]
    """Spec of each scene as nested tables, complete."""
    methods: dict[str, Method]
    """By name."""
    experiments: dict[str, Experiment]
    """By name, in the order of the file."""
    is_quick: bool
    """Whether it is the short form."""

    def spec(self, scene: str, case: Case) -> SceneSpec:
        """Spec of a scene in a case."""
        return parse_spec(merge_tables(self.scenes[scene], case.scene), where=f"scene {scene}")

    def config(self, method: str, case: Case | None = None) -> PresetConfig:
        """Constants of a method, in a case."""
        how, where = self.methods[method], f"method {method}"
        changes = how.settings
        if case is not None and case.settings:
            changes, where = merge_tables(changes, case.settings), f"{where} in case {case.label!r}"
        config = preset_of_table({**changes, "preset": how.preset}, where)
        if how.kind == "oracle" and config.preset != "matched-filter":
            raise UserError(what="an oracle is of the preset matched-filter", where=where)
        return config


def load_suite(path: Path | None = None, *, quick: bool = False) -> Suite:
    """Read a suite and check every scene and method in every case.

    path: TOML file, to which paths of meshes are relative; the package's own when None.
    quick: only the experiments marked as quick, on reduced scenes.
    """
    where = path or files("geraf2.apps.benchmark") / OWN_SUITE
    file, folder = read_toml(where, _File), path.parent if path is not None else None
    suites = {form: _suite(file, form, folder) for form in (True, False)}
    for suite in suites.values():
        _check(suite, where)
    return suites[quick]


def _suite(file: _File, quick: bool, folder: Path | None) -> Suite:
    scenes = {}
    for name, own in file.scenes.items():
        spec = merge_tables(file.base, own)
        if quick:
            spec = merge_tables(spec, file.quick)
        mesh = spec.get("figure", {}).get("mesh")
        if mesh is not None and folder is not None:
            spec = merge_tables(spec, {"figure": {"mesh": str(folder / mesh)}})
        scenes[name] = spec
    methods, chosen = file.methods, file.experiments
    if quick:
        methods = {
            k: replace(m, settings=merge_tables(m.settings, m.quick)) for k, m in methods.items()
        }
        chosen = {name: _quick(e) for name, e in chosen.items() if e.quick}
    chosen = {name: _with_scene(e) for name, e in chosen.items()}
    return Suite(scenes=scenes, methods=methods, experiments=chosen, is_quick=quick)


def _with_scene(experiment: Experiment) -> Experiment:
    """Experiment with its common changes of scenes copied into its cases."""
    if not experiment.scene:
        return experiment
    cases = (replace(c, scene=merge_tables(experiment.scene, c.scene)) for c in experiment.cases)
    return replace(experiment, cases=tuple(cases))


def _quick(experiment: Experiment) -> Experiment:
    wanted = experiment.quick_cases
    return replace(
        experiment,
        scenes=experiment.quick_scenes or experiment.scenes,
        methods=experiment.quick_methods or experiment.methods,
        cases=tuple(c for c in experiment.cases if not wanted or c.label in wanted),
    )


def _check(suite: Suite, where: object) -> None:
    for method in suite.methods:
        suite.config(method)
        suite.methods[method].run_options(0)
    for name, experiment in suite.experiments.items():
        published = experiment.published
        scenes = (*experiment.scenes, *published)
        methods = (*experiment.methods, *(m for own in published.values() for m in own))
        _require(f"experiment {name}: no such scene", scenes, suite.scenes, where)
        _require(f"experiment {name}: no such method", methods, suite.methods, where)
        for case in experiment.cases:
            for method in experiment.methods:
                suite.config(method, case)
            for scene in experiment.scenes:
                if not suite.spec(scene, case).walls:
                    raise UserError(what=f"scene {scene} has no walls", where=where)


def _require(what: str, names: Iterable[str], known: Mapping[str, Any], where: object) -> None:
    for name in names:
        if name not in known:
            raise UserError(what=what, where=where, expected="one of " + ", ".join(known), got=name)
