"""Line-of-sight priors as folders (mesh, distance grid, record), from photos, meshes or sides."""

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geraf2 import __version__
from geraf2._types import Floats, Progress
from geraf2.apps.photos.formats import find_photos, open_photos
from geraf2.apps.photos.photo_checks import check_photos, require_photos_in_view
from geraf2.apps.photos.photo_store import load_photos
from geraf2.calibration.box_finder import find_box
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.fields.mesh_distance import cut_by_box, grid_about, largest_body, mesh_distance
from geraf2.geometry.shells import outer_shells
from geraf2.geometry.transforms import apply_rigid
from geraf2.geometry.triangles import count_open_edges
from geraf2.io.atomic import write_json_atomic
from geraf2.io.container import LOS_RECORD_NAME, is_scene
from geraf2.io.digests import file_digest
from geraf2.io.mesh import TriangleMesh, read_mesh, write_mesh
from geraf2.io.outputs import require_consent, require_folder
from geraf2.io.regular import RECORD_BYTES, read_regular
from geraf2.io.run_folder import stage_key
from geraf2.io.text import parse_json
from geraf2.pipeline.events import Listener
from geraf2.pipeline.los_options import LosOptions, PhotoPreset
from geraf2.scene import load_capture
from geraf2.scene.checks import require_no_errors
from geraf2.scene.los import LosPrior
from geraf2.scene.photos import PhotoSet
from geraf2.scene.summary import CaptureSummary

if TYPE_CHECKING:
    from geraf2.apps.photos.config import PhotoConfig
    from geraf2.apps.photos.neural_surface import NeuralSurface

MESH_NAME = "los.ply"
FIELD_NAME = "los.npz"
VIEWS_NAME = "views.png"
REFUSED_NAME = "refused.png"
"""Views of a surface that does not explain its photos; it becomes no prior."""

# Raised when the same photos and settings give another surface.
PHOTOS_VERSION = 3
_N_LONGEST = 128
_MAX_NOTES = 8
"""Largest number of notes that are printed."""
# Boxes are scanned from tens of centimetres; a house is 20 m.
_MAX_BOX_M = 20.0
_MIN_BOX_M = 1e-3
# Shortest over longest side below which a mesh is a sheet.
_FLAT = 1e-4
_SIDES = re.compile(r"(?:x|,\s*|\s+)".join([r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"] * 3))


def photo_config(preset: PhotoPreset, seed: int = 0) -> "PhotoConfig":
    """Return the settings of a training on fine grids, or on coarse ones for a first look."""
    from geraf2.apps.photos import config  # noqa: PLC0415 - torch takes 2 s

    if preset == "default":
        return config.PhotoConfig(seed=seed)
    stages = tuple(config.GridStage(n_longest=n, n_steps=k) for n, k in ((48, 200), (80, 300)))
    return config.PhotoConfig(stages=stages, seed=seed)


@dataclass(frozen=True, kw_only=True)
class LosRecord:
    """Where a prior came from, for los.json."""

    kind: str
    """photos, mesh, box or radar."""
    source: str
    """As the user named it."""
    key: str
    """Hash of everything that it depends on."""
    numbers: dict[str, Any] = field(default_factory=dict)
    """Results of the training, or of the search in a scan."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LosResult:
    """A prior and its folder."""

    path: Path
    """The folder."""
    prior: LosPrior
    """Outside of the box, in the capture frame [m]; its walls are unknown."""
    record: LosRecord
    """Where it came from."""
    files: tuple[str, ...]
    """Names of its files in the folder."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LosPhotos:
    """A checked photo set and the options of its training."""

    source: Path
    photos: PhotoSet
    options: LosOptions

    @property
    def key(self) -> str:
        """Hash of everything that the surface depends on."""
        return stage_key(
            version=PHOTOS_VERSION,
            photos=self.photos,
            config=photo_config(self.options.preset, self.options.seed),
            bounds=self.options.limits(),
            hold_out=self.options.hold_out,
        )

    def make(self, folder: Path, listener: Listener) -> tuple[str, ...]:
        """Train the surface into a folder, or keep that of this key; names of its files."""
        return train_los(self, folder, listener).files


def make_los(
    source: str | Path,
    out: Path | str,
    options: LosOptions | None = None,
    *,
    box_center_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    overwrite: bool = False,
    num_threads: int | None = None,
    listener: Listener | None = None,
) -> LosResult:
    """Make the prior of a box in a folder from photos, a mesh, side lengths or a radar scan.

    Parameters
    ----------
    source
        Photos with poses, a mesh (closed, or a scan with holes), a scene, whose box is found by
        :func:`find_box`, or three outer side lengths in metres, as "0.22x0.22x0.22".
    out
        Folder for los.ply, los.npz, los.json and pictures. A prior of the same photos and options
        that lies there is kept; an interrupted training is continued.
    options
        Interpretation of the source, and settings of the training.
    box_center_m
        Middle of a box of given sides [m].
    overwrite
        Replace a finished prior of something else in the folder.
    num_threads
        Threads to use; all when None.
    listener
        Receives progress, warnings and findings.

    Returns
    -------
    LosResult
        The prior, closed and in metres, and its folder.

    Raises
    ------
    UserError
        If the source cannot be read or shows no box, if options do not fit it, or if the folder
        holds something else, which stays unchanged.

    Examples
    --------
    >>> made = geraf2.make_los("0.22x0.22x0.11", "los")
    >>> [round(side, 6) for side in made.prior.size_m]
    [0.22, 0.22, 0.11]
    """
    options, listener, path = options or LosOptions(), listener or Listener(), Path(source)
    out, sides = Path(out), _SIDES.fullmatch(str(source))
    _require_own(out)
    kind, mesh, numbers = "mesh", None, dict[str, Any]()
    if is_scene(path):
        with listener.step("box"):
            box = find_box(load_capture(path), num_threads=num_threads)
        kind, mesh, numbers = "radar", box.prior.mesh, {"by_radar": str(box), **box.numbers()}
    elif sides is not None and not path.exists():
        x, y, z = (float(side) for side in sides.groups())
        if not (min(x, y, z) >= _MIN_BOX_M and max(x, y, z) <= _MAX_BOX_M):
            raise UserError(
                what="box sides must be positive lengths in metres",
                expected=f"{_MIN_BOX_M:g} to {_MAX_BOX_M:g} m",
                got=source,
            )
        if options.unit is not None or options.to_radar is not None:
            what = "side lengths are metres in the capture's frame: leave out --unit and --to-radar"
            raise UserError(what=what)
        kind, mesh = "box", LosPrior.from_box((x, y, z), box_center_m).mesh
    elif is_photo_set(path) or path.is_dir():
        if not is_photo_set(path):
            open_photos(path)  # raises an error that names the missing file
        photos = read_photos(path, options, listener)
        _require_same(out, photos.key, overwrite=overwrite)
        return train_los(photos, out, listener, num_threads)
    mesh, limits = mesh or _read_in_frame(path, options), options.limits()
    key = stage_key(vertices=mesh.vertices, faces=mesh.faces, bounds=limits)
    _require_same(out, key, overwrite=overwrite)
    record = LosRecord(kind=kind, source=str(source), key=key, numbers=numbers)
    return _make_from_mesh(mesh, out, record, limits, num_threads, listener)


def is_photo_set(path: Path) -> bool:
    """Whether a path holds photos with poses, and is no finished prior."""
    return not (path / LOS_RECORD_NAME).is_file() and find_photos(path) is not None


def read_photos(source: Path, options: LosOptions, listener: Listener | None = None) -> LosPhotos:
    """Read and check a photo set; findings go to the listener, UserError if it is unusable."""
    listener = listener or Listener()
    if options.hold_out < 0 or options.hold_out == 1:
        raise UserError(what="--hold-out must be 0 or at least 2", got=options.hold_out)
    loaded = load_photos(source, options)
    for note in loaded.notes[:_MAX_NOTES]:
        listener.warning(f"{source}: {note}")
    if len(loaded.notes) > _MAX_NOTES:
        listener.warning(f"{source}: {len(loaded.notes) - _MAX_NOTES} more such lines")
    listener.findings(require_no_errors(check_photos(loaded.photos), source))
    if loaded.photos.masks is None:
        raise UserError(
            what="shows no silhouettes of the box, without which its surface is not found",
            where=source,
            hint="give --masks or --mask-threshold, or photos with an alpha channel",
        )
    return LosPhotos(source=source, photos=loaded.photos, options=options)


class PhotoPriors:
    """Maker of priors from photos, an entry point of the group `geraf2.priors`."""

    def read(
        self, source: Path, options: LosOptions, summary: CaptureSummary, listener: Listener
    ) -> LosPhotos | None:
        """Photos with poses that show the radar's scene; None where `source` holds none."""
        if not is_photo_set(source):
            return None
        photos = read_photos(source, options, listener)
        if summary.focus is not None:
            require_photos_in_view(photos.photos, summary.focus, summary.standoff_m, source)
        return photos


def train_los(
    job: LosPhotos, folder: Path, listener: Listener, num_threads: int | None = None
) -> LosResult:
    """Train the surface of a photo set into a folder, or keep the existing one.

    `num_threads` becomes torch's number; None leaves it. UserError where the surface is clearly
    not that of the photos; the folder then keeps its prior.
    """
    import torch  # noqa: PLC0415 - takes 2 s

    from geraf2.apps.photos import los_views  # noqa: PLC0415 - needs torch
    from geraf2.report.los import surface_views  # noqa: PLC0415 - matplotlib takes 0.5 s

    if num_threads is not None:
        torch.set_num_threads(num_threads)
    options = job.options
    kept = _load_kept(folder, job.key, [VIEWS_NAME])
    if kept is not None:
        with listener.step("surface from photos (done before)"):
            los_views.warn_unexplained(kept.record.numbers, job.source, listener)
            return kept
    trained, held = los_views.hold_out(job.photos, options.hold_out)
    checkpoint = folder / f"training-{job.key[:12]}.safetensors"
    folder.mkdir(parents=True, exist_ok=True)
    with listener.step("surface from photos") as report:
        surface = _train(job, trained, checkpoint, report)
    sdf, limits, mesh = surface.sdf(), options.limits(), None
    if limits is None:
        mesh = surface.mesh()
    else:
        sdf = largest_body(cut_by_box(sdf, limits))
    numbers: dict[str, Any] = {"n_photos": len(trained)}
    numbers["n_held_out"] = len(job.photos) - len(trained)
    views, seen = los_views.compare_few(surface, trained if held is None else held)
    if held is None:
        numbers |= {f"{los_views.TRAINED}{name}": value for name, value in seen.items()}
    else:
        numbers |= los_views.compare_views(surface, held)[1]
    refused = los_views.is_refuted(numbers)
    surface_views(views, folder / (REFUSED_NAME if refused else VIEWS_NAME))
    if refused:
        raise los_views.refutation_error(numbers, job.source, folder / REFUSED_NAME)
    los_views.warn_unexplained(numbers, job.source, listener)
    record = LosRecord(kind="photos", source=str(job.source), key=job.key, numbers=numbers)
    made = write_los(folder, sdf, record, mesh=mesh, others=[VIEWS_NAME], frame=job.photos.frame)
    checkpoint.unlink(missing_ok=True)
    return made


def _train(job: LosPhotos, photos: PhotoSet, checkpoint: Path, report: Progress) -> "NeuralSurface":
    from geraf2.apps.photos.training import train_neural_surface  # noqa: PLC0415 - torch takes 2 s
    from geraf2.apps.photos.visual_hull import Region  # noqa: PLC0415 - with it

    limits, region = job.options.limits(), None
    if limits is not None and np.isfinite(limits).all():
        margin = 0.05 * (limits[1] - limits[0]).max()
        region = Region.from_corners(limits[0] - margin, limits[1] + margin)
    return train_neural_surface(
        photos,
        photo_config(job.options.preset, job.options.seed),
        region=region,
        progress=lambda trainer, _: report(trainer.step_number / trainer.n_steps),
        checkpoint=checkpoint,
        resume=True,
    )


def write_los(
    folder: Path,
    sdf: SdfGrid,
    record: LosRecord,
    *,
    frame: str = "capture",
    mesh: TriangleMesh | None = None,
    others: Sequence[str] = (),
) -> LosResult:
    """Write mesh, distance grid and record of a prior; its zero level is the mesh if none is given.

    UserError for a grid without a surface, or a mesh that is not closed.
    """
    from geraf2.surfaces.isosurface import (  # noqa: PLC0415 - scikit-image takes 0.3 s
        extract_surface,
    )

    mesh = extract_surface(sdf) if mesh is None else mesh
    if mesh.faces.shape[0] == 0:
        raise UserError(
            what="there is no surface",
            where=record.source,
            hint="do the photos show the box, and do --bounds and masks leave it in?",
        )
    prior = LosPrior.from_mesh(mesh, where=record.source)
    made_from = {"source": Path(record.source).name, "key": record.key, "command": "geraf2 los"}
    write_mesh(prior.mesh, folder / MESH_NAME, frame=frame, made_from=made_from)
    sdf.save(folder / FIELD_NAME)
    names = [MESH_NAME, MESH_NAME + ".json", FIELD_NAME, *others]
    values = {
        "format": "geraf2-los",
        "version": 1,
        "generator": f"geraf2 {__version__}",
        **asdict(record),
        "unit": "m",
        "frame": frame,
        "size_m": list(prior.size_m),
        "center_m": list(prior.center_m),
        "n_faces": int(prior.faces.shape[0]),
        "files": {name: file_digest(folder / name) for name in names},
    }
    write_json_atomic(folder / LOS_RECORD_NAME, values)
    return LosResult(path=folder, prior=prior, record=record, files=(*names, LOS_RECORD_NAME))


def _load_kept(folder: Path, key: str, others: list[str]) -> LosResult | None:
    """Prior of this key with these files in a folder; None if any is missing or harmed."""
    stored = _read_record(folder)
    if stored is None:
        return None
    record, files = stored
    whole = all(file_digest(folder / name) == digest for name, digest in files.items())
    if not (record.key == key and whole and {MESH_NAME, *others} <= set(files)):
        return None
    prior = LosPrior.from_mesh(read_mesh(folder / MESH_NAME), where=folder)
    return LosResult(path=folder, prior=prior, record=record, files=(*files, LOS_RECORD_NAME))


def _read_record(folder: Path) -> tuple[LosRecord, dict[str, str]] | None:
    """Record of a finished prior and the digests of its files; None where there is none."""
    try:
        values = parse_json(read_regular(folder / LOS_RECORD_NAME, RECORD_BYTES))
        record = LosRecord(**{name: values[name] for name in LosRecord.__dataclass_fields__})
        return record, dict(values["files"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _make_from_mesh(
    mesh: TriangleMesh,
    out: Path,
    record: LosRecord,
    limits: Floats | None,
    num_threads: int | None,
    listener: Listener,
) -> LosResult:
    """Prior of a mesh, whose holes are closed by its distance grid."""
    with listener.step("distance grid") as progress:
        bounds = np.stack([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])
        closed = count_open_edges(mesh.faces) == 0
        grid = grid_about(bounds, _N_LONGEST)
        sdf = mesh_distance(mesh, grid, closed=closed, num_threads=num_threads, progress=progress)
        if not closed:
            voxel_mm = 1e3 * grid.spacing_m
            listener.warning(
                f"{record.source}: the mesh has holes; a grid of {voxel_mm:.2g} mm closed them"
            )
        if closed and limits is None:
            return write_los(out, sdf, record, mesh=mesh)
        sdf = largest_body(sdf if limits is None else cut_by_box(sdf, limits))
        return write_los(out, sdf, record)


def _read_in_frame(path: Path, options: LosOptions) -> TriangleMesh:
    """Mesh of a file in metres, in the capture frame."""
    rigid, unit_m = options.placement()
    mesh = read_mesh(path, any_unit=unit_m is not None)
    sides = np.ptp(mesh.vertices, axis=0) * (unit_m or 1.0)
    if not _MIN_BOX_M <= sides.max() <= _MAX_BOX_M:
        is_long = sides.max() > _MAX_BOX_M
        raise UserError(
            what=f"the mesh is {sides.max():.4g} m long",
            where=path,
            expected=f"{_MIN_BOX_M:g} to {_MAX_BOX_M:g} m",
            hint="is it in millimetres? then add --unit mm" if is_long else None,
        )
    if not sides.min() > _FLAT * sides.max():
        raise UserError(what="the mesh is flat and encloses nothing", where=path)
    vertices = mesh.vertices * (unit_m or 1.0)
    moved = vertices if rigid is None else apply_rigid(rigid, vertices)
    placed = TriangleMesh(vertices=moved, faces=mesh.faces)
    if count_open_edges(mesh.faces):
        return placed
    return placed.with_faces(mesh.faces[outer_shells(moved, mesh.faces)])


def _require_own(out: Path) -> None:
    """Refuse a folder with foreign files; remains of an interrupted command are allowed."""
    ours = (out / LOS_RECORD_NAME).is_file() or any(out.glob("training-*.safetensors"))
    known = {MESH_NAME, MESH_NAME + ".json", FIELD_NAME, VIEWS_NAME, REFUSED_NAME}
    left = out.is_dir() and all(entry.name in known for entry in out.iterdir())
    require_folder(out, "prior", own=ours or left)


def _require_same(out: Path, key: str, *, overwrite: bool) -> None:
    """Refuse to replace a finished prior of another source."""
    stored = _read_record(out)
    if stored is not None and stored[0].key != key:
        require_consent(out, f"a finished prior of {stored[0].source!r}", overwrite=overwrite)
