"""A matched-filter volume larger than a memory: image.zarr, a chunk for each slab of the grid.

    OUT/image.zarr/     zarr v3 group; its attributes hold unit, frame, position and request
        volume          float32 (x, y, z); a chunk is a slab, written whole

Slabs are imaged one after another here, or on workers elsewhere. A chunk that is there is done,
whoever wrote it: the same command continues where it stopped. The bytes are those of the volume
of `geraf2 image`, which is imaged in the same slabs.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geraf2._memory import require_memory
from geraf2._types import Floats
from geraf2.errors import UserError
from geraf2.geometry.transforms import triple
from geraf2.imaging.slabs import Slabs
from geraf2.imaging.volume import image_volume
from geraf2.io.atomic import atomic_folder, write_bytes_atomic, write_text_atomic
from geraf2.io.objects import (
    absolute_path,
    exists,
    is_file,
    is_remote,
    list_files,
    local_folder,
    read_bytes,
    remove,
)
from geraf2.io.outputs import require_consent
from geraf2.io.regular import RECORD_BYTES
from geraf2.io.run_folder import OF_IMAGE, RUN_NAME, RunFolder
from geraf2.io.text import parse_json
from geraf2.io.zarr_files import METADATA_NAME, ZarrArray, group_text, write_group
from geraf2.pipeline.commands.image import (
    ImageOptions,
    ImagePlan,
    ImageRecord,
    draw_image,
    explain_image,
    filter_angles,
    note_image,
    plan_image,
)
from geraf2.pipeline.estimates import slab_bytes
from geraf2.pipeline.events import Listener
from geraf2.scene.store import open_capture

TILES_NAME = "image.zarr"
VOLUME_NAME = "volume"


@dataclass(frozen=True, kw_only=True)
class SlabJob:
    """Input of a worker that images any slab: paths and numbers."""

    scene: Path
    """Scene folder, under the path by which all workers see it."""
    group: Path
    """image.zarr."""
    slabs: Slabs
    poses: tuple[int, ...]
    angles_deg: tuple[float, float] | None
    memory_bytes: float
    """Input of the process of one slab."""

    def chunk(self, number: int) -> Path:
        """File of a slab; it is there when the slab is done."""
        index = ["0"] * 3
        index[self.slabs.axis] = str(number)
        return self.group.joinpath(VOLUME_NAME, "c", *index)

    def remaining(self) -> list[int]:
        """Slabs that are not done."""
        numbers = range(len(self.slabs))
        if is_remote(self.group):  # one question for all
            there = list_files(self.group)
            return [n for n in numbers if str(self.chunk(n).relative_to(self.group)) not in there]
        return [n for n in numbers if not self.chunk(n).is_file()]

    def read(self, number: int) -> NDArray[np.float32]:
        """Read a slab."""
        shape = [*self.slabs.grid.shape]
        shape[self.slabs.axis] = self.slabs.n_layers
        values = np.frombuffer(read_bytes(self.chunk(number)), dtype="<f4").reshape(shape)
        return values[tuple(slice(n) for n in self.slabs.part(number).shape)]


RunSlabs = Callable[[SlabJob, list[int]], Iterable[int]]
"""Images slabs, and yields the number of each as it is done."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TiledImage(ImageRecord):
    """A volume that lies in chunks in a run folder."""

    slabs: Slabs
    n_done: int
    """Slabs that were imaged now; the others were there."""
    strongest_m: tuple[float, float, float]
    """Position of the largest value [m]."""


def image_tiles(
    scene: Path | str,
    out: Path,
    options: ImageOptions | None = None,
    *,
    run_slabs: RunSlabs | None = None,
    overwrite: bool = False,
    num_threads: int | None = None,
    listener: Listener | None = None,
) -> TiledImage:
    """Image a scene slab by slab into image.zarr; slabs that are there are kept.

    scene: folder of the scene; poses are read one at a time.
    out: run folder, as of :func:`geraf2.pipeline.commands.image.image_scene`.
    options: poses, voxels, angles, memory of a slab.
    run_slabs: who images them; this process, one after another, when None.
    overwrite: replace an image of other options, finished or not, or the run of another scene.

    Returns where the image lies and what is in it [m]. UserError as of `image_scene`.
    """
    listener = listener or Listener()
    plan = plan_image(scene, options or ImageOptions(), listener, in_parts=True)
    job = slab_job(plan, Path(scene), out / TILES_NAME)
    if run_slabs is None:
        require_memory(job.memory_bytes, "lower --slab-gib", where="a slab")
    with local_folder(out, only=[RUN_NAME]) as folder:
        run = RunFolder.open(
            folder, scene_digest=plan.digest, scene_name=plan.name, overwrite=overwrite
        )
        key = plan.key(tiles=True, slab_layers=plan.slabs.n_layers)
        run.require_same("image", key, "image", overwrite=overwrite)
        run.begin()
        with run.rewrite(*OF_IMAGE):
            start = time.perf_counter()
            _prepare(job, plan, key, overwrite=overwrite)
            method, left = explain_image(plan), job.remaining()
            _image(job, left, run_slabs or partial(_image_here, num_threads), plan.step, listener)
            with listener.step("looking at the slabs"):
                seen = _survey(job, plan.axis)
            if plan.axis is not None:
                plan.warn_of_ends(seen.sharpness, listener)
            attributes = {**plan.describe(VOLUME_NAME, seen.sharpness), "key": key}
            write_text_atomic(job.group / METADATA_NAME, group_text(attributes))
            with listener.step("drawing"):
                draw_image(plan, run.path, seen.maxima, seen.sharpness, partial(_read_slice, job))
            note_image(run, key, time.perf_counter() - start, method)
    return TiledImage(
        path=out,
        files=(TILES_NAME, *plan.pictures),
        slabs=plan.slabs,
        n_done=len(left),
        method=method,
        strongest_m=seen.strongest_m,
        depths_m=plan.depths_m,
        sharpness=seen.sharpness,
        searched_m=plan.searched_m,
    )


def slab_job(plan: ImagePlan, scene: Path, group: Path) -> SlabJob:
    """Paths and numbers of a plan, for workers."""
    largest = max(plan.imaged.pose_sizes, default=0) * plan.imaged.waveform.n_samples
    return SlabJob(
        scene=absolute_path(scene),
        group=absolute_path(group),
        slabs=plan.slabs,
        poses=tuple(plan.poses),
        angles_deg=plan.options.angles_deg,
        memory_bytes=slab_bytes(plan.slabs, largest),
    )


def image_slab(job: SlabJob, number: int, num_threads: int | None = None) -> int:
    """Image a slab and write its chunk, unless that is there; the number of the slab."""
    path = job.chunk(number)
    if is_file(path):
        return number
    if not is_file(job.group / METADATA_NAME):
        raise UserError(what="the worker does not see the image's folder", where=job.group)
    capture, part = open_capture(job.scene), job.slabs.part(number)
    capture = filter_angles(job.angles_deg, capture, job.poses)
    values = image_volume(capture, part, poses=job.poses, num_threads=num_threads)
    n_missing = job.slabs.n_layers - part.shape[job.slabs.axis]
    padding = [(0, 0)] * 3
    padding[job.slabs.axis] = (0, n_missing)
    whole = np.pad(values, padding) if n_missing else values
    write_bytes_atomic(path, np.ascontiguousarray(whole, dtype="<f4").data.cast("B"))
    return number


def _image(
    job: SlabJob, left: list[int], run_slabs: RunSlabs, label: str, listener: Listener
) -> None:
    """Image the missing slabs, and check that they are there."""
    n_slabs = len(job.slabs)
    with listener.step(f"{label} in {n_slabs} slabs") as report:
        for n_done, _ in enumerate(run_slabs(job, left) if left else ()):
            report((n_slabs - len(left) + n_done + 1) / n_slabs)
    if missing := job.remaining():
        raise UserError(
            what=f"{len(missing)} of {n_slabs} slabs are missing",
            where=job.group,
            hint="do the workers see the same folder? The same command continues",
        )


def _image_here(num_threads: int | None, job: SlabJob, left: list[int]) -> Iterator[int]:
    for number in left:
        yield image_slab(job, number, num_threads)


def _prepare(job: SlabJob, plan: ImagePlan, key: str, *, overwrite: bool) -> None:
    """Make image.zarr without chunks; one of the same key stays as it is."""
    try:
        about = parse_json(read_bytes(job.group / METADATA_NAME, RECORD_BYTES))
        same = about["attributes"]["key"] == key
    except (OSError, ValueError, KeyError, TypeError):
        same = False
    if same:
        return
    if exists(job.group):
        require_consent(job.group, "a tiled image of other settings", overwrite=overwrite)
    slabs, chunks = job.slabs, [*job.slabs.grid.shape]
    chunks[slabs.axis] = slabs.n_layers
    volume = ZarrArray(
        name=VOLUME_NAME,
        dtype="<f4",
        fill=0.0,
        dimensions=("x", "y", "z"),
        shape=slabs.grid.shape,
        chunks=tuple(chunks),
        attributes={"unit": "1", "long_name": "magnitude of the matched-filter image"},
    )
    with _new_group(job.group) as group:
        write_group(group, {**plan.describe(VOLUME_NAME, np.zeros(0)), "key": key})
        volume.write_metadata(group)


@contextmanager
def _new_group(path: Path) -> Iterator[Path]:
    """Temporary folder that replaces the group when the body ends."""
    if not is_remote(path):
        with atomic_folder(path) as folder:
            yield folder
        return
    for name in list_files(path):
        remove(path / name)
    with local_folder(path) as folder:
        yield folder


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    maxima: list[NDArray[np.float32]]
    """Largest values along x, y and z."""
    strongest_m: tuple[float, float, float]
    sharpness: Floats


def _survey(job: SlabJob, axis: int | None) -> _Seen:
    """Iterate over the slabs, one in memory at a time."""
    grid = job.slabs.grid
    shapes = [tuple(n for a, n in enumerate(grid.shape) if a != along) for along in range(3)]
    maxima = [np.zeros(shape, dtype=np.float32) for shape in shapes]
    largest, strongest = -1.0, (0.0, 0.0, 0.0)
    second, fourth = np.zeros((2, 0 if axis is None else grid.shape[axis]))
    for number in range(len(job.slabs)):
        values, index, part = job.read(number), job.slabs.index(number), job.slabs.part(number)
        for along, found in enumerate(maxima):
            seen = found[tuple(s for a, s in enumerate(index) if a != along)]
            np.maximum(seen, values.max(axis=along), out=seen)
        best = np.unravel_index(int(values.argmax()), values.shape)
        if values[best] > largest:
            largest = float(values[best])
            strongest = triple(along[i] for along, i in zip(part.axes_m, best, strict=True))
        if axis is not None:
            slices = np.moveaxis(values, axis, 0).reshape(values.shape[axis], -1)
            power = slices.astype(np.float64) ** 2
            second[index[axis]] += power.sum(axis=1)
            fourth[index[axis]] += (power**2).sum(axis=1)
    n_across = 1 if axis is None else grid.n_voxels // grid.shape[axis]
    sharpness = n_across * np.divide(fourth, second**2, out=np.zeros_like(second), where=second > 0)
    return _Seen(maxima=maxima, strongest_m=strongest, sharpness=sharpness)


def _read_slice(job: SlabJob, index: int, axis: int) -> NDArray[np.float32]:
    slabs = job.slabs
    if axis == slabs.axis:
        number, inside = divmod(index, slabs.n_layers)
        return np.asarray(job.read(number).take(inside, axis=axis))
    parts = [job.read(number).take(index, axis=axis) for number in range(len(slabs))]
    return np.concatenate(parts, axis=slabs.axis - (slabs.axis > axis))
