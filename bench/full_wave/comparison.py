"""Full-wave captures against the simulator's captures of the same bodies and plan.

    python bench/full_wave/comparison.py CAPTURES OUT [--presets fast best]

CAPTURES is what captures.py made. What is done is kept in OUT.
"""

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from geraf2.apps.benchmark.runner import RESULT_NAME, RUNS_FOLDER, SCENES_FOLDER, read_record
from geraf2.echoes.glint_set import Glints
from geraf2.errors import UserError
from geraf2.evaluation import MeshMetrics
from geraf2.imaging.volume import image_volume
from geraf2.io.atomic import write_json_atomic
from geraf2.io.container import LOS_NAME, TRUTH_NAME, is_scene
from geraf2.io.mesh import read_mesh
from geraf2.io.run_folder import GLINTS_NAME, stage_key
from geraf2.pipeline.commands.evaluate import evaluate
from geraf2.pipeline.commands.reconstruct import reconstruct
from geraf2.pipeline.commands.simulate import simulate_scene
from geraf2.pipeline.presets import preset_type, versions_of
from geraf2.pipeline.prior import PriorSource
from geraf2.scene import Grid, load_capture
from geraf2.simulation import load_spec
from geraf2.surfaces.isosurface import signed_distances

SCENE_NAME, TWIN_NAME = "scene", "twin.toml"
"""In the folder of a body: its capture, and the spec of the same scan by physical optics."""
# Raised when a number means something else.
_VERSION = 1
_SPACING_M, _MARGIN_M = 0.002, 0.01  # of the heat maps, about the body
_AWAY_M = 0.005  # a glint farther than this from the truth is a ghost
_ON_SURFACE_M = 0.004  # a tenth of the width of a heat map's peak in range
_MIN_SHARE = 1e-9  # of the energy; equal maps differ by -90 dB
_KINDS = ("full wave", "physical optics")
_SCORES = (
    "body       preset  echo             F1 5 mm   3 mm   2 mm  in sight  glints, mm  ghosts, %"
)
_HEATS = "heat maps  difference, dB  outside, %  inside, %  largest at x, y, z, mm"


@dataclass(frozen=True, kw_only=True)
class Heat:
    """Difference of two heat maps, each scaled to the same energy."""

    difference_db: float
    """Energy of the difference over that of the simulator's map [dB]."""
    outside_share: float
    """Share of the difference's energy outside the body and off its surface."""
    inside_share: float
    """The same inside the body."""
    at_m: tuple[float, float, float]
    """Where the difference is largest [m]."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """A reconstruction against the truth."""

    f1: tuple[float, float, float]
    """F1 at 5, 3 and 2 mm."""
    in_sight_f1_5mm: float
    """F1 at 5 mm of the part in sight of the antennas."""
    glint_median_m: float
    """Median distance of glints to the truth [m]."""
    ghost_share: float
    """Share of the glints farther than 5 mm from the truth."""


def bodies(captures: Path) -> list[Path]:
    """Folders of the bodies; UserError where there is none."""
    found = sorted(
        p.parent for p in captures.glob(f"*/{TWIN_NAME}") if is_scene(p.parent / "scene")
    )
    if not found:
        raise UserError(
            what="no full-wave captures",
            where=captures,
            hint=f"make them: python bench/full_wave/captures.py {captures}",
        )
    return found


def compare(
    folders: Sequence[Path], presets: Sequence[str], out: Path, num_threads: int | None = None
) -> list[str]:
    """Lines of the table of all bodies, of these folders; what is done is kept in `out`."""
    scores, heats = [_SCORES], [_HEATS]
    for folder in folders:
        name, scene = folder.name, folder / SCENE_NAME
        twin = out / SCENES_FOLDER / f"{name}-physical-optics"
        if not is_scene(twin):
            twin.parent.mkdir(parents=True, exist_ok=True)
            simulate_scene(load_spec(folder / TWIN_NAME), twin, num_threads=num_threads)
        heats.append(_heat_line(name, heat_difference(scene, twin, num_threads)))
        for preset in presets:
            for source, kind in zip((scene, twin), _KINDS, strict=True):
                run = out / RUNS_FOLDER / f"{name}-{kind.replace(' ', '-')}-{preset}"
                found = score(scene, source, preset, run, num_threads)
                scores.append(_score_line(name, preset, kind, found))
    return [*scores, "", *heats]


def score(
    truth: Path, scene: Path, preset: str, run: Path, num_threads: int | None = None
) -> Score:
    """Reconstruct a scene in the prior of another one and measure it against its truth, once.

    truth: scene folder with truth and prior.
    """
    config = preset_type(preset)()
    key = stage_key(version=_VERSION, config=config, stages=versions_of(config))
    known = read_record(run / RESULT_NAME)
    if known.get("key") == key:
        return Score(**{name: known[name] for name in Score.__dataclass_fields__})
    prior = PriorSource(los=truth / LOS_NAME)
    result = reconstruct(scene, prior, config, run, overwrite=True, num_threads=num_threads)
    metrics = evaluate(result, truth / TRUTH_NAME, report=False, num_threads=num_threads)
    glints = Glints.load(run / GLINTS_NAME)
    away = np.abs(signed_distances(read_mesh(truth / TRUTH_NAME), glints.positions))
    found = Score(
        f1=(metrics.f1(0.005), metrics.f1(0.003), metrics.f1(0.002)),
        in_sight_f1_5mm=_in_sight(metrics),
        glint_median_m=float(np.median(away)),
        ghost_share=float(np.mean(away > _AWAY_M)),
    )
    write_json_atomic(run / RESULT_NAME, {"key": key, **asdict(found)})
    return found


def heat_difference(scene: Path, twin: Path, num_threads: int | None = None) -> Heat:
    """Difference of the heat maps of a scene and its twin about the scene's truth."""
    truth = read_mesh(scene / TRUTH_NAME)
    low, high = truth.vertices.min(axis=0) - _MARGIN_M, truth.vertices.max(axis=0) + _MARGIN_M
    shape = np.ceil((high - low) / _SPACING_M).astype(int) + 1
    grid = Grid.centered(0.5 * (low + high), _SPACING_M, shape)
    full, own = (
        image_volume(load_capture(path), grid, num_threads=num_threads) for path in (scene, twin)
    )
    parts = np.square(full / np.linalg.norm(full) - own / np.linalg.norm(own)).ravel()
    parts += _MIN_SHARE / parts.size
    signed = signed_distances(truth, grid.points())
    x, y, z = grid.points()[np.argmax(parts)].tolist()
    return Heat(
        difference_db=float(10 * np.log10(parts.sum())),
        outside_share=float(parts[signed > _ON_SURFACE_M].sum() / parts.sum()),
        inside_share=float(parts[signed < -_ON_SURFACE_M].sum() / parts.sum()),
        at_m=(x, y, z),
    )


def _in_sight(metrics: MeshMetrics) -> float:
    for part in metrics.by_sight:
        if part.part == "in sight":
            return next(s.f1 for s in part.scores if s.threshold_m == 0.005)
    return float("nan")


def _score_line(name: str, preset: str, kind: str, found: Score) -> str:
    five, three, two = found.f1
    return (
        f"{name:10s} {preset:7s} {kind:16s} {five:7.3f} {three:6.3f} {two:6.3f} "
        f"{found.in_sight_f1_5mm:9.3f} {1e3 * found.glint_median_m:11.2f} "
        f"{100 * found.ghost_share:10.1f}"
    )


def _heat_line(name: str, heat: Heat) -> str:
    x, y, z = (f"{1e3 * value:.0f}" for value in heat.at_m)
    return (
        f"{name:10s} {heat.difference_db:14.1f} {100 * heat.outside_share:11.0f} "
        f"{100 * heat.inside_share:10.0f}  {x}, {y}, {z}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("captures", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--presets", nargs="+", default=["fast", "best"])
    given = parser.parse_args()
    print("\n".join(compare(bodies(given.captures), given.presets, given.out)))


if __name__ == "__main__":
    main()
