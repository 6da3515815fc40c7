"""Runs rows: scenes and results are kept by what they were made from."""

import json
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from skimage.filters import threshold_otsu

from geraf2.baselines import MatchedFilterConfig
from geraf2.baselines.heat import counted_voxels, grid_inside
from geraf2.baselines.matched_filter_surface import sum_heat, surface_above
from geraf2.benchmark.processes import run_measured
from geraf2.benchmark.rows import Row, RowResult
from geraf2.benchmark.suite import Method
from geraf2.errors import UserError
from geraf2.evaluation import MeshMetrics, evaluate_mesh, oracle_matched_filter, write_metrics
from geraf2.io.atomic import write_json_atomic
from geraf2.io.container import LOS_NAME, PHOTOS_NAME, TRUTH_NAME
from geraf2.io.mesh import read_mesh
from geraf2.io.run_folder import CONTENT_NAME, METRICS_NAME, RunFolder, mesh_digest, stage_key
from geraf2.io.toml import write_toml
from geraf2.scene import LosPrior, Wall, load_capture
from geraf2.scene.store import save_capture
from geraf2.simulation import SceneSpec
from geraf2.surfaces.extraction import cropped_content

RESULT_NAME = "result.json"
SCENES_FOLDER, RUNS_FOLDER = "scenes", "runs"
# Raised when the simulator or the evaluation gives something else from the same spec.
_SCENE_VERSION, _RESULT_VERSION = 1, 2
# Thresholds that the oracle tries, in units of Otsu's; the method's own is among them.
_ORACLE_SCALES = (0.8, 1.0, 1.15, 1.3, 1.45, 1.6, 1.8, 2.0, 2.3, 2.6)


class Keys(NamedTuple):
    """What a row is known by."""

    scene: str
    result: str


@dataclass
class Runner:
    """Makes scenes and runs under one folder, each once."""

    out: Path
    """Folder of the benchmark."""
    command: Sequence[str]
    """How `geraf2` is called: in a process of its own, so that a failure is one row's."""
    versions: Callable[[Row], Mapping[str, int]]
    """Of the stages that a row runs: results of other versions are made again."""
    seed: int = 0
    """Of scenes, reconstructions and evaluation."""
    num_threads: int | None = None
    """Threads of each process; all when None."""
    warn: Callable[[str], None] = lambda _: None
    """Told of what went wrong."""
    _locks: dict[str, threading.Lock] = field(default_factory=dict)
    _guard: threading.Lock = field(default_factory=threading.Lock)

    def run(self, row: Row) -> RowResult:
        """Figures of a row: from an earlier run, or a new one; a failure is its result."""
        scene_key, key, run = self._place(row)
        with self._lock(key):  # tables share rows
            done = _read_result(run, key)
            if done is not None:
                return done
            try:
                with self._lock(scene_key):
                    scene = self._scene(row, scene_key)
                start = time.thread_time()
                result = self._figures(row, scene, run)
                own = time.thread_time() - start
            except (UserError, OSError, ValueError, subprocess.SubprocessError) as error:
                text = " ".join(str(error).split())
                self.warn(f"{row.name}: {text}")
                return RowResult(error=text)
            result = replace(
                result,
                all_cpu_seconds=(result.all_cpu_seconds or 0.0) + own,
                folder=str(run.relative_to(self.out)),
                scene_folder=str(scene.relative_to(self.out)),
            )
            run.mkdir(parents=True, exist_ok=True)
            write_json_atomic(run / RESULT_NAME, {"key": key, "row": row.name, **result.to_dict()})
            return result

    def known(self, row: Row) -> RowResult | None:
        """Figures of a row from an earlier run; None where there are none."""
        _, key, run = self._place(row)
        return _read_result(run, key)

    def keys(self, row: Row) -> Keys:
        """Keys under which a row's scene and result are kept; tables share both."""
        scene_key, key, _ = self._place(row)
        return Keys(scene=scene_key, result=key)

    def known_scene_seconds(self, row: Row) -> float | None:
        """Processor time that a row's scene took [s]; None where it is not known."""
        path = self._scene_folder(row, self._scene_key(row)).with_suffix(".json")
        try:
            seconds = json.loads(path.read_text(encoding="utf-8"))["cpu_seconds"]
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return float(seconds) if isinstance(seconds, int | float) else None

    def _scene_folder(self, row: Row, key: str) -> Path:
        return self.out / SCENES_FOLDER / f"{row.scene}-{key[:10]}"

    def _place(self, row: Row) -> tuple[str, str, Path]:
        """Key of a row's scene, key of its result, and its run folder."""
        scene_key = self._scene_key(row)
        key = stage_key(
            version=_RESULT_VERSION,
            scene=scene_key,
            arguments=row.arguments,
            kind=[row.how.kind, row.how.oracle_spacing_m],
            shift=row.case.prior_shift_m,
            stages=dict(self.versions(row)),
            seed=self.seed,
        )
        return scene_key, key, self.out / RUNS_FOLDER / f"{row.scene}-{row.method}-{key[:10]}"

    def _lock(self, key: str) -> threading.Lock:
        with self._guard:
            return self._locks.setdefault(key, threading.Lock())

    def _scene_key(self, row: Row) -> str:
        told = row.case.told_permittivity
        return stage_key(version=_SCENE_VERSION, spec=row.spec, seed=self.seed, told=told)

    def _scene(self, row: Row, key: str) -> Path:
        """Folder of the simulated scene."""
        scene = self._scene_folder(row, key)
        if scene.is_dir():  # made whole or not at all
            return scene
        spec = scene.with_suffix(".toml")
        spec.parent.mkdir(parents=True, exist_ok=True)
        write_toml(spec, row.spec)
        told = row.case.told_permittivity
        if told == "true":
            spent = self._geraf2("simulate", str(spec), str(scene), "--seed", str(self.seed))
            write_json_atomic(scene.with_suffix(".json"), {"cpu_seconds": spent})
            return scene
        plain = Row(**{**row.__dict__, "case": replace(row.case, told_permittivity="true")})
        true_key = self._scene_key(plain)
        with self._lock(true_key):
            true_scene = self._scene(plain, true_key)
        _tell_walls(true_scene, scene, told)
        return scene

    def _figures(self, row: Row, scene: Path, run: Path) -> RowResult:
        if row.how.kind == "oracle":
            return self._oracle(row.spec, row.how, scene)
        shutil.rmtree(run, ignore_errors=True)  # without a result it is of a failure
        if row.how.kind == "photos":
            return self._photos(row, scene, run)
        more = (*_prior_arguments(row, scene), "--no-report", "--seed", str(self.seed))
        spent = self._geraf2("reconstruct", str(scene), str(run), *more, *row.arguments)
        psnr_db = None
        if row.how.kind == "render":
            spent += self._geraf2("render", str(run))
            views = json.loads((run / "views" / "psnr.json").read_text(encoding="utf-8"))
            psnr_db = float(views["mean_psnr_db"])
        content = read_mesh(run / CONTENT_NAME)
        if content.faces.shape[0] == 0:
            return RowResult(error="nothing reconstructed", psnr_db=psnr_db)
        metrics = evaluate_mesh(
            content,
            read_mesh(scene / TRUTH_NAME),
            seed=self.seed,
            num_threads=self.num_threads,
        )
        write_metrics(metrics, run / METRICS_NAME, extra=mesh_digest(run))
        return replace(
            _result_of(metrics),
            psnr_db=psnr_db,
            cpu_seconds=sum(done.cpu_seconds for done in RunFolder.read(run).stages.values()),
            all_cpu_seconds=spent,
        )

    def _photos(self, row: Row, scene: Path, run: Path) -> RowResult:
        """Surface from photos beside what they show."""
        photos = row.spec.photos
        if photos is None:
            raise UserError(what="the scene has no photos", where=f"scene {row.scene}")
        spent = self._geraf2("los", str(scene / PHOTOS_NAME), str(run), *row.arguments)
        truth = scene / LOS_NAME
        if photos.subject == "content":
            truth = scene / TRUTH_NAME
            shutil.copy(run / LOS_NAME, run / CONTENT_NAME)  # as the galleries call it
        metrics = evaluate_mesh(
            read_mesh(run / LOS_NAME),
            read_mesh(truth),
            seed=self.seed,
            num_threads=self.num_threads,
        )
        write_metrics(metrics, run / METRICS_NAME, extra=mesh_digest(run))
        return replace(_result_of(metrics), all_cpu_seconds=spent)

    def _oracle(self, spec: SceneSpec, how: Method, scene: Path) -> RowResult:
        capture = load_capture(scene)
        wall = spec.walls[0]
        prior = LosPrior.from_box(wall.size_m, wall.center_m, capture.walls)
        config = MatchedFilterConfig(spacing_m=how.oracle_spacing_m)
        grid = grid_inside(prior, config.spacing_m)
        total = sum_heat(capture, grid, num_threads=self.num_threads)
        truth = read_mesh(scene / TRUTH_NAME)
        best = oracle_matched_filter(
            total.heat, grid, prior, truth, crop_m=config.crop_m, seed=self.seed,
            num_threads=self.num_threads,
        )  # fmt: skip
        scores = [(best.f1_15mm, best.f1_5mm, best.chamfer_1e3_m2)]
        counted = counted_voxels(prior, grid, config.crop_m, num_threads=self.num_threads)
        otsu = float(threshold_otsu(total.heat[counted]))
        hottest = float(total.heat[counted].max())
        for threshold in (scale * otsu for scale in _ORACLE_SCALES if scale * otsu < hottest):
            sdf = surface_above(capture, total, counted, threshold, config.normal_reach_m)
            mesh, _ = cropped_content(sdf, prior, config.crop_m, num_threads=self.num_threads)
            if mesh.faces.shape[0]:
                metrics = evaluate_mesh(mesh, truth, seed=self.seed, num_threads=self.num_threads)
                scores.append((metrics.f1(0.015), metrics.f1(0.005), metrics.chamfer_1e3_m2))
        f1_15mm, f1_5mm, chamfer = zip(*scores, strict=True)
        return RowResult(f1_15mm=max(f1_15mm), f1_5mm=max(f1_5mm), chamfer_1e3_m2=min(chamfer))

    def _geraf2(self, *arguments: str) -> float:
        """Run a command -> processor time [s]; UserError with its last line where it fails."""
        threads: list[str] = []
        if self.num_threads is not None:
            threads = ["--threads", str(self.num_threads)]
        code, errors, seconds = run_measured([*self.command, *arguments, *threads])
        if code != 0:
            lines = [line for line in errors.splitlines() if line.strip()]
            said = lines[-1].removeprefix("geraf2: ") if lines else f"exit code {code}"
            raise UserError(what=f"geraf2 {arguments[0]}: {said}")
        return seconds


def _result_of(metrics: MeshMetrics) -> RowResult:
    return RowResult(
        f1_15mm=metrics.f1(0.015),
        f1_5mm=metrics.f1(0.005),
        f1_3mm=metrics.f1(0.003),
        chamfer_1e3_m2=metrics.chamfer_1e3_m2,
        median_m=metrics.both_ways.median_m,
    )


def _prior_arguments(row: Row, scene: Path) -> list[str]:
    if not any(row.case.prior_shift_m):
        return ["--los", str(scene / LOS_NAME)]
    wall = row.spec.walls[0]
    center = [c + s for c, s in zip(wall.center_m, row.case.prior_shift_m, strict=True)]
    return ["--box", *map(repr, wall.size_m), "--box-center", *map(repr, center)]


def _tell_walls(true_scene: Path, scene: Path, told: float | str) -> None:
    """Copy a scene that says something else of its walls."""
    capture = load_capture(true_scene)
    walls: tuple[Wall, ...] = ()
    if isinstance(told, float):
        walls = tuple(replace(wall, permittivity=told) for wall in capture.walls)

    def write_extras(folder: Path) -> None:
        for name in (TRUTH_NAME, LOS_NAME):
            shutil.copy(true_scene / name, folder / name)

    save_capture(replace(capture, walls=walls), scene, extras=write_extras)


def _read_result(run: Path, key: str) -> RowResult | None:
    try:
        values = json.loads((run / RESULT_NAME).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(values, dict) or values.get("key") != key:
        return None
    return RowResult.from_dict(values)
