"""Jobs of a batch: scene, outside of the box, settings; from folders or a table."""

import csv
import glob
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePath

from geraf2._bounds import Triple
from geraf2.errors import UserError
from geraf2.io.container import (
    LOS_NAME,
    MANIFEST_NAME,
    RADAR_NAME,
    TRUTH_NAME,
    is_scene,
    read_scene_manifest,
)
from geraf2.io.objects import absolute_path, exists, is_file, is_remote, list_files, read_bytes
from geraf2.io.regular import RECORD_BYTES
from geraf2.io.run_folder import stage_key
from geraf2.io.text import parse_json, read_lines
from geraf2.io.toml import nearest_name
from geraf2.io.zarr_files import METADATA_NAME
from geraf2.pipeline.estimates import Estimate, reconstruct_cost
from geraf2.pipeline.presets import BestPreset, PresetConfig, versions_of
from geraf2.pipeline.prior import PriorSource
from geraf2.pipeline.run_record import RunOptions

# Increased when the same job gives another record.
_RESULT_VERSION = 2
COLUMNS = ("scene", "box", "prior", "truth")
"""Columns of a table of scans; only the first is required."""


@dataclass(frozen=True, kw_only=True)
class BatchJob:
    """Reconstruction of one scene, scored where its truth is known."""

    scene: Path
    """Scene folder."""
    prior: PriorSource = field(default_factory=PriorSource)
    """Outside of the box; by default the scene's own los.ply, or the box that it states, or as
    the radar sees it."""
    truth: Path | None = None
    """Mesh of the truth, in metres in the scene's frame."""
    options: RunOptions = field(default_factory=RunOptions)
    config: PresetConfig = field(default_factory=BestPreset)
    """Preset and its constants."""

    def resolve(self) -> "BatchJob":
        """Return the job with absolute paths; UserError for missing files."""
        if not is_scene(self.scene):
            read_scene_manifest(self.scene)  # raises the error
        prior, own = self.prior, self.scene / LOS_NAME
        if prior.los is None and prior.box is None:
            prior = replace(prior, los=own if is_file(own) else None)
        for path in (prior.los, self.truth):
            if path is not None and not exists(path):
                raise UserError(what="no such file", where=path)
        los, truth = (None if p is None else absolute_path(p) for p in (prior.los, self.truth))
        return replace(
            self, scene=absolute_path(self.scene), prior=replace(prior, los=los), truth=truth
        )

    @property
    def settings(self) -> str:
        """Hash of preset, constants and options."""
        return stage_key(options=self.options, config=self.config)

    @property
    def key(self) -> str:
        """Hash of all inputs: scene, prior, truth, settings, versions of the stages.

        Files are identified by name, size and modification time: reading all samples would take
        longer than submitting the jobs. The run folder identifies its scene by content.
        """
        prior = replace(self.prior, los=None)
        return stage_key(
            version=_RESULT_VERSION,
            scene=[self.scene.name, fingerprint(self.scene)],
            prior=[prior, None if self.prior.los is None else fingerprint(self.prior.los)],
            truth=None if self.truth is None else fingerprint(self.truth),
            settings=self.settings,
            stages=versions_of(self.config),
        )

    @property
    def estimate(self) -> Estimate | None:
        """Processor time and memory; None where the size of the scene is unknown."""
        try:
            about = parse_json(
                read_bytes(self.scene / RADAR_NAME / "signal" / METADATA_NAME, RECORD_BYTES)
            )
            n_poses, n_antennas, n_samples = (int(n) for n in about["shape"][:3])
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return reconstruct_cost(n_poses * n_antennas * n_samples, preset=self.config.preset)


def fingerprint(path: Path) -> str:
    """Hash of names, sizes and times of change of a file, or of all files of a folder."""
    if is_remote(path):
        found = list_files(path)
        return stage_key(files=[[name, size, tag] for name, (size, tag) in found.items()])
    paths = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    stats = [(p, p.stat()) for p in paths]
    return stage_key(files=[[str(p.relative_to(path)), s.st_size, s.st_mtime_ns] for p, s in stats])


def read_jobs(
    sources: Sequence[Path | str],
    *,
    los: Path | None = None,
    box: Triple | None = None,
    config: PresetConfig | None = None,
    options: RunOptions | None = None,
) -> list[BatchJob]:
    """Jobs of scene folders, patterns of them (`scans/*`), and CSV tables with a row for each scan.

    los, box: default outside of the box, as of `geraf2 reconstruct` [m].
    config, options: of all jobs.

    Returns a job for each scene, with the truth of its folder. Raises UserError for a missing
    scene, an unknown column, and a scene with two different boxes.
    """
    if los is not None and box is not None:
        raise UserError(what="give either --los or --box", got="both")
    base = BatchJob(
        scene=Path(),
        prior=PriorSource(los=los, box=box),
        options=options or RunOptions(),
        config=config or BestPreset(),
    )
    found = (job.resolve() for source in sources for job in _read_source(str(source), base))
    return require_distinct(found)


def require_distinct(jobs: Iterable[BatchJob]) -> list[BatchJob]:
    """Jobs without repetitions; UserError for conflicting jobs, equal names, or no job."""
    by_scene: dict[Path, BatchJob] = {}
    by_name: dict[str, Path] = {}
    for job in jobs:
        if by_name.setdefault(job.scene.name, job.scene) != job.scene:
            raise UserError(
                what="two scenes have the same name, which identifies a scene in a batch",
                where=job.scene,
                got=by_name[job.scene.name],
                hint="give each an OUT of its own, or rename one",
            )
        if by_scene.setdefault(job.scene, job) != job:
            raise UserError(
                what="the same scene twice, with different boxes, truths or settings",
                where=job.scene,
                hint="give each a batch, and an OUT, of its own",
            )
    if not by_scene:
        raise UserError(what="there is no scene to be reconstructed")
    return list(by_scene.values())


def _read_source(source: str, base: BatchJob) -> Iterator[BatchJob]:
    path = Path(source)
    if path.suffix == ".csv":
        yield from _read_table(path, base)
        return
    names = [source]
    if glob.has_magic(source) and not exists(path):
        names = sorted(_match_names(path))
        if not names:
            raise UserError(what="no scene has such a name", where=source)
    for name in names:
        yield replace(base, scene=Path(name), truth=_own_truth(Path(name)))


def _match_names(pattern: Path) -> list[str]:
    """Folders whose path matches a pattern; in an object store, scenes only."""
    if not is_remote(pattern):
        return glob.glob(str(pattern), recursive=True)  # noqa: PTH207 - may be absolute
    first = next(i for i, part in enumerate(pattern.parts) if glob.has_magic(part))
    above = Path(*pattern.parts[:first])
    scenes = (above / name for name in list_files(above) if PurePath(name).name == MANIFEST_NAME)
    return [str(scene.parent) for scene in scenes if scene.parent.match(str(pattern))]


def _own_truth(scene: Path) -> Path | None:
    return scene / TRUTH_NAME if is_file(scene / TRUTH_NAME) else None


def _read_table(table: Path, base: BatchJob) -> Iterator[BatchJob]:
    reader = csv.DictReader(read_lines(table), skipinitialspace=True)
    try:
        rows = [(f"{table}, line {reader.line_num}", row) for row in reader]
    except csv.Error as error:
        raise UserError(what=f"cannot be read: {error}", where=table) from None
    for name in reader.fieldnames or ():
        if name not in COLUMNS:
            what = f"unknown column {name!r}{nearest_name(name, COLUMNS)}"
            raise UserError(what=what, where=table, expected=", ".join(COLUMNS))
    if "scene" not in (reader.fieldnames or ()):
        raise UserError(what="has no column 'scene'", where=table)
    for where, row in rows:
        if None in row or None in row.values():
            raise UserError(what="has more or fewer cells than columns", where=where)
        yield _read_row(row, table.parent, base, where)


def _read_row(row: dict[str, str], folder: Path, base: BatchJob, where: str) -> BatchJob:
    if not row["scene"]:
        raise UserError(what="names no scene", where=where)
    scene, prior, box = _resolve_cell(folder, row["scene"]), row.get("prior"), row.get("box")
    if prior and box:
        raise UserError(what="give either box or prior", where=where, got="both")
    source = base.prior
    if prior:
        source = PriorSource(los=_resolve_cell(folder, prior))
    if box:
        source = PriorSource(box=_lengths(box, where))
    truth = _resolve_cell(folder, row["truth"]) if row.get("truth") else _own_truth(scene)
    return replace(base, scene=scene, prior=source, truth=truth)


def _resolve_cell(folder: Path, name: str) -> Path:
    """Path in a cell, relative to the table, or absolute, or an address."""
    return Path(name) if is_remote(name) else folder / name


def _lengths(text: str, where: str) -> Triple:
    try:
        x, y, z = (float(word) for word in text.replace("x", " ").split())
    except ValueError:
        raise UserError(what="box", where=where, expected="three lengths [m]", got=text) from None
    return x, y, z
