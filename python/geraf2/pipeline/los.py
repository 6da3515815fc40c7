"""Line-of-sight priors as folders: mesh, distance grid, record; trained from photos or made."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from geraf2 import __version__
from geraf2.cli._console import print_findings, progress_bar, warn
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.fields.mesh_distance import cut_by_box, grid_about, largest_body, mesh_distance
from geraf2.geometry.triangles import count_open_edges
from geraf2.imaging.volume import image_volume
from geraf2.io.atomic import write_json_atomic
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.io.photos import find_photos
from geraf2.io.run_folder import RunFolder, file_digest, stage_key
from geraf2.pipeline.los_options import PhotoFlags, PhotoPreset
from geraf2.scene import Capture, Grid
from geraf2.scene.los import LosPrior
from geraf2.scene.photo_checks import require_photos_in_view, require_plausible_photos
from geraf2.scene.photo_store import load_photos
from geraf2.scene.photos import PhotoSet, bin_pixels
from geraf2.scene.summary import CaptureSummary

if TYPE_CHECKING:
    from geraf2.photos.config import PhotoConfig
    from geraf2.photos.neural_surface import NeuralSurface
    from geraf2.photos.training import PhotoProgress

LOS_STAGE = "los"
"""Stage of a run, and its folder."""
MESH_NAME = "los.ply"
FIELD_NAME = "los.npz"
RECORD_NAME = "los.json"
SURFACE_NAME = "surface.safetensors"
VIEWS_NAME = "views.png"

# Raised when the same photos and settings give another surface.
PHOTOS_VERSION = 2
_N_LONGEST = 128
_VIEW_HEIGHT = 300
_N_VIEWS = 3
_N_HEAT_VOXELS = 56
_N_HEAT_POSES = 8
_MAX_NOTES = 8
"""Where half of 200 photos are missing, a few lines say so."""


@dataclass(frozen=True, kw_only=True)
class LosRecord:
    """Where a prior came from, for los.json."""

    kind: str
    """photos, mesh or box."""
    source: str
    """As the user named it."""
    key: str
    """Hash of everything that it depends on."""
    numbers: dict[str, Any] = field(default_factory=dict)
    """What came out."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LosPhotos:
    """A photo set that was read and checked, and how it is to be trained."""

    source: Path
    photos: PhotoSet
    flags: PhotoFlags

    @property
    def key(self) -> str:
        """Hash of everything that the surface depends on."""
        return stage_key(
            version=PHOTOS_VERSION,
            photos=self.photos,
            config=photo_config(self.flags.preset, self.flags.seed),
            bounds=self.flags.limits(),
            hold_out=self.flags.hold_out,
        )


def photo_config(preset: PhotoPreset, seed: int) -> "PhotoConfig":
    """Look the settings of a training up by name."""
    from geraf2.photos.config import (  # noqa: PLC0415 - torch takes 2 s
        GridPhotoConfig,
        GridStage,
        MlpPhotoConfig,
    )

    if preset == "paper":
        return MlpPhotoConfig(seed=seed)
    if preset == "default":
        return GridPhotoConfig(seed=seed)
    stages = (GridStage(n_longest=48, n_steps=200), GridStage(n_longest=80, n_steps=300))
    return GridPhotoConfig(stages=stages, seed=seed)


def is_photo_set(path: Path) -> bool:
    """Whether a path holds photos with poses, and is no finished prior."""
    return not (path / RECORD_NAME).is_file() and find_photos(path) is not None


def read_photos(source: Path, flags: PhotoFlags) -> LosPhotos:
    """Read a photo set and say what is odd about it."""
    if flags.hold_out < 0 or flags.hold_out == 1:
        raise UserError(what="--hold-out must be 0 or at least 2", got=flags.hold_out)
    loaded = load_photos(source, flags.options())
    for note in loaded.notes[:_MAX_NOTES]:
        warn(f"{source}: {note}")
    if len(loaded.notes) > _MAX_NOTES:
        warn(f"{source}: {len(loaded.notes) - _MAX_NOTES} more such lines")
    print_findings(require_plausible_photos(loaded.photos, source))
    if loaded.photos.masks is None:
        warn(
            f"{source}: without silhouettes the surface may be off by centimetres; give "
            f"--masks, and look at {VIEWS_NAME}"
        )
        if flags.bounds is None:
            warn(
                f"{source}: no masks: what the box stands on becomes part of the surface; give "
                "--masks or cut it off with --bounds"
            )
    return LosPhotos(source=source, photos=loaded.photos, flags=flags)


def is_made(folder: Path, key: str, others: list[str]) -> bool:
    """Whether a folder holds the prior of this key with these files, unharmed."""
    try:
        record = json.loads((folder / RECORD_NAME).read_text(encoding="utf-8"))
        files = dict(record["files"])
    except (OSError, ValueError, KeyError, TypeError):
        return False
    whole = all(file_digest(folder / name) == digest for name, digest in files.items())
    return record.get("key") == key and whole and {MESH_NAME, *others} <= set(files)


def photos_of_los(los: Path | None, flags: PhotoFlags, summary: CaptureSummary) -> LosPhotos | None:
    """Photos of --los, read, checked, and looking where the radar does; None for anything else."""
    if los is None or not is_photo_set(los):
        return None
    photos = read_photos(los, flags)
    if summary.focus is not None:
        require_photos_in_view(photos.photos, summary.focus, summary.standoff_m, los)
    return photos


def trained_los(run: RunFolder, photos: LosPhotos) -> Path:
    """Folder of the prior of these photos in a run: trained, or kept if they are the same."""
    start, folder = time.perf_counter(), run.path / LOS_STAGE
    kept = run.is_done(LOS_STAGE, photos.key)
    files = train_los(photos, folder)
    if not kept:
        seconds = time.perf_counter() - start
        run.mark_done(LOS_STAGE, photos.key, [f"{LOS_STAGE}/{name}" for name in files], seconds)
        run.log("done", level="info", stage=LOS_STAGE, seconds=round(seconds, 3))
    return folder


def heat_map(
    capture: Capture, prior: LosPrior, num_threads: int | None
) -> tuple[NDArray[np.float32], Grid]:
    """Coarse heat map of some poses around a prior, for the report."""
    grid = grid_about(prior.bounds, _N_HEAT_VOXELS)
    n_poses = len(capture.poses)
    chosen = sorted({int(i) for i in np.linspace(0, n_poses - 1, min(n_poses, _N_HEAT_POSES))})
    return image_volume(capture, grid, poses=chosen, num_threads=num_threads), grid


def train_los(job: LosPhotos, folder: Path) -> list[str]:
    """Train the surface of a photo set into a folder, or keep the one that is there.

    Returns
    -------
    Names of the files of the prior.
    """
    others = [VIEWS_NAME, *([SURFACE_NAME] if job.flags.keep_surface else [])]
    if is_made(folder, job.key, others):
        with progress_bar("surface from photos (done before)"):
            return _files_of(folder)
    trained, held = _split(job.photos, job.flags.hold_out)
    checkpoint = folder / f"training-{job.key[:12]}.safetensors"
    folder.mkdir(parents=True, exist_ok=True)
    with progress_bar("surface from photos") as report:
        surface = _train(job, trained, checkpoint, report)
    sdf = surface.sdf()
    limits, mesh = job.flags.limits(), None
    if limits is None:
        mesh = surface.mesh()
    else:
        sdf = largest_body(cut_by_box(sdf, limits))
    if job.flags.keep_surface:
        surface.save(folder / SURFACE_NAME)
    shown = held if held is not None else trained
    numbers: dict[str, Any] = {
        "n_photos": len(trained),
        "n_held_out": len(job.photos) - len(trained),
    }
    if held is not None:
        numbers |= _compare(surface, held)
    _draw_views(surface, shown, folder / VIEWS_NAME)
    files = write_los(
        folder,
        sdf,
        LosRecord(kind="photos", source=str(job.source), key=job.key, numbers=numbers),
        mesh=mesh,
        others=others,
        frame=job.photos.frame,
    )
    checkpoint.unlink(missing_ok=True)
    return files


def _train(
    job: LosPhotos, photos: PhotoSet, checkpoint: Path, report: Callable[[float], None]
) -> "NeuralSurface":
    from geraf2.photos.training import train_neural_surface  # noqa: PLC0415 - torch takes 2 s
    from geraf2.photos.visual_hull import Region  # noqa: PLC0415 - with it

    def told(progress: "PhotoProgress") -> None:
        report(progress.step / progress.n_steps)

    limits, region = job.flags.limits(), None
    if limits is not None and np.isfinite(limits).all():
        margin = 0.05 * (limits[1] - limits[0]).max()
        low, high = limits[0] - margin, limits[1] + margin
        region = Region(
            low_m=(float(low[0]), float(low[1]), float(low[2])),
            high_m=(float(high[0]), float(high[1]), float(high[2])),
        )
    return train_neural_surface(
        photos,
        photo_config(job.flags.preset, job.flags.seed),
        region=region,
        progress=told,
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
) -> list[str]:
    """Write mesh, distance grid and record of a prior; its zero level is the mesh if none is given.

    Returns
    -------
    Names of all files of the prior.
    """
    from geraf2.surfaces.isosurface import (  # noqa: PLC0415 - scikit-image takes 0.3 s
        extract_surface,
    )

    outer = extract_surface(sdf) if mesh is None else mesh
    if outer.faces.shape[0] == 0:
        raise UserError(
            what="there is no surface",
            where=record.source,
            hint="do the photos show the box, and do --bounds and masks leave it in?",
        )
    prior = LosPrior.from_mesh(outer, where=record.source)
    write_mesh(
        TriangleMesh(vertices=prior.vertices, faces=prior.faces), folder / MESH_NAME, frame=frame
    )
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
    write_json_atomic(folder / RECORD_NAME, values)
    return [*names, RECORD_NAME]


def _files_of(folder: Path) -> list[str]:
    record = json.loads((folder / RECORD_NAME).read_text(encoding="utf-8"))
    return [*record["files"], RECORD_NAME]


def mesh_field(mesh: TriangleMesh, num_threads: int | None = None) -> tuple[SdfGrid, bool]:
    """Distance grid of a mesh, and whether the mesh is closed; holes are closed by the grid."""
    bounds = np.stack([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])
    closed = count_open_edges(mesh.faces) == 0
    grid = grid_about(bounds, _N_LONGEST)
    return mesh_distance(mesh, grid, closed=closed, num_threads=num_threads), closed


def _split(photos: PhotoSet, every: int) -> tuple[PhotoSet, PhotoSet | None]:
    """Photos to train with, and those held out."""
    if every == 0:
        return photos, None
    index = np.arange(len(photos))
    held = index % every == every - 1
    return photos.subset(index[~held]), photos.subset(index[held])


def _compare(surface: "NeuralSurface", held: PhotoSet) -> dict[str, float]:
    """PSNR over the object (the whole picture without masks), and overlap of the silhouettes."""
    errors, overlaps = [], []
    for index, camera in enumerate(held.cameras):
        view = surface.render(camera)
        difference = view.colour - held.images[index].astype(np.float32) / 255.0
        if held.masks is None:
            errors.append(float(np.mean(difference**2)))
            continue
        mask, seen = held.masks[index], view.opacity > 0.5
        errors.append(float(np.mean(difference[mask] ** 2)) if mask.any() else 0.0)
        overlaps.append(float((mask & seen).sum() / max((mask | seen).sum(), 1)))
    numbers = {"psnr_db": float(-10.0 * np.log10(max(float(np.mean(errors)), 1e-12)))}
    if overlaps:
        numbers["silhouette_iou"] = float(np.mean(overlaps))
    return numbers


def _draw_views(surface: "NeuralSurface", photos: PhotoSet, path: Path) -> None:
    from geraf2.report.los import SurfaceView, surface_views  # noqa: PLC0415 - matplotlib: 0.5 s

    views = []
    for index in np.linspace(0, len(photos) - 1, min(_N_VIEWS, len(photos))).round().astype(int):
        camera, image = photos.cameras[index], photos.images[index]
        step = max(1, camera.height // _VIEW_HEIGHT)
        view = surface.render(camera.binned(step))
        small = bin_pixels(image, step).round().astype(np.uint8)
        views.append(
            SurfaceView(photos.names[index], small, view.colour, view.normal, view.opacity)
        )
    surface_views(views, path)
