"""Photo sets from files, in the capture frame and in metres."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geraf2._types import Array, Bools, Floats
from geraf2.apps.photos.formats import open_photos
from geraf2.apps.photos.formats.images import ReadImage, read_image, read_mask
from geraf2.apps.photos.formats.masks import threshold_mask
from geraf2.errors import UserError
from geraf2.geometry.boxes import SIGNS
from geraf2.geometry.transforms import OPENGL_TO_OPENCV, require_rigid
from geraf2.io.photo_files import PhotoRecord
from geraf2.pipeline.los_options import CameraAxes, LosOptions
from geraf2.scene.photos import Camera, PhotoSet, bin_pixels

_MAX_SIDE_PX = 1600
"""Larger photos are read as means of 2 x 2, 3 x 3, ... pixels."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadedPhotos:
    """A photo set and the notes of its reader."""

    photos: PhotoSet
    """Usable photos."""
    format: str
    """Format of the source."""
    notes: tuple[str, ...]
    """One line each on omissions and assumptions."""


def load_photos(path: Path | str, options: LosOptions | None = None) -> LoadedPhotos:
    """Read a photo set of any known format.

    path: folder or file, see :func:`geraf2.apps.photos.formats.open_photos`.
    options: unit, frame, masks.

    Missing or broken photos are left out with a note; UserError if none is usable, and for options
    that contradict each other.
    """
    options = LosOptions() if options is None else options
    rigid, given_m = options.placement()
    if options.mask_threshold is not None and options.masks is not None:
        raise UserError(what="give either --masks or --mask-threshold", got="both")
    if options.masks is not None and not options.masks.is_dir():
        raise UserError(what="--masks must be a folder", got=options.masks)
    source = open_photos(Path(path))
    unit_m, notes = source.unit_m if given_m is None else given_m, list(source.notes)
    if unit_m is None:
        unit_m = 1.0
        notes.append(
            "poses of COLMAP have an arbitrary scale; --unit sets their unit in metres"
            if source.format == "colmap"
            else "the poses name no unit; metres are assumed (--unit sets another)"
        )
    names, cameras, images = list[str](), list[Camera](), list[Array]()
    masks: list[Bools | None] = []
    tagged: list[str] = []
    for record in source.records:
        try:
            image = read_image(record.path, record.size)
            camera = _camera(record, image, unit_m, rigid, source.format, options.camera_axes)
            mask = _mask(record, image, camera, options)
        except UserError as error:
            notes.append(f"left out: {error}")
            continue
        step = -(-max(image.colour.shape[:2]) // _MAX_SIDE_PX)
        names.append(record.name)
        tagged += [record.name] if image.is_tagged else []
        cameras.append(camera.join_pixels(step))
        images.append(bin_pixels(image.colour, step).round().astype(np.uint8))
        masks.append(None if mask is None else bin_pixels(mask, step) >= 0.5)
    if not names:
        raise UserError(
            what=f"none of the {len(source.records)} photos can be used",
            where=path,
            hint=notes[-1] if notes else None,
        )
    if tagged:
        notes.append(
            f"{len(tagged)} photos with an EXIF orientation were taken as stored (e.g. "
            f"{tagged[0]}); if their poses are of the upright pictures, turn the pixels first, for "
            "example with ImageMagick's 'mogrify -auto-orient'"
        )
    known = [mask for mask in masks if mask is not None]
    if known and len(known) < len(masks):
        notes.append(f"only {len(known)} of {len(masks)} photos have a mask")
    photos = PhotoSet(
        names=tuple(names),
        cameras=tuple(cameras),
        images=tuple(images),
        masks=tuple(known) if len(known) == len(masks) else None,
        frame=source.frame if source.frame and rigid is None else "capture",
    )
    return LoadedPhotos(photos=photos, format=source.format, notes=tuple(notes))


def _camera(
    record: PhotoRecord,
    image: ReadImage,
    unit_m: float,
    rigid: Floats | None,
    format_name: str,
    axes: CameraAxes,
) -> Camera:
    transform = require_rigid(record.camera_to_world, record.name)
    transform[:3, 3] *= unit_m
    native = "opengl" if format_name == "transforms" else "opencv"
    if axes not in ("format", native):
        transform = transform @ OPENGL_TO_OPENCV
    if rigid is not None:
        transform = require_rigid(rigid, "to_capture") @ transform
    height, width = image.colour.shape[:2]
    stored_width, stored_height = record.size or (width, height)
    k1, k2, p1, p2, k3 = (float(value) for value in record.distortion)
    focal = np.diag(record.intrinsics)[:2]
    # Far below a pixel; a denormal number would become 0 in an image of another size.
    if not np.isfinite(record.intrinsics).all() or min(focal) < 1e-6:
        raise UserError(
            what="focal lengths must be finite and positive", where=record.name, got=focal.tolist()
        )
    camera = Camera(
        intrinsics=record.intrinsics,
        camera_to_world=transform,
        width=stored_width,
        height=stored_height,
        distortion=(k1, k2, p1, p2, k3),
    )
    if (stored_width, stored_height) == (width, height):
        return camera
    if abs(stored_width * height - stored_height * width) > max(stored_width, stored_height):
        raise UserError(
            what="the image has another shape than its camera",
            where=record.path,
            expected=f"{stored_width} x {stored_height} or a smaller copy",
            got=f"{width} x {height}",
        )
    return camera.resize(width, height)


def _mask(
    record: PhotoRecord, image: ReadImage, camera: Camera, options: LosOptions
) -> Bools | None:
    limits = options.limits()
    is_closed = limits is not None and np.isfinite(limits).all()
    within = box_outline(camera, limits) if limits is not None and is_closed else None
    if options.masks is not None:
        mask = read_mask(_mask_file(options.masks, record))
    elif options.mask_threshold is not None:
        return threshold_mask(image.colour, options.mask_threshold, within)
    elif record.mask_path is not None:
        mask = read_mask(record.mask_path)
    elif image.alpha is not None and (image.alpha < 255).any():
        mask = np.asarray(image.alpha >= 128)
    else:
        return None
    if mask.shape != image.colour.shape[:2]:
        raise UserError(
            what="the mask has another size than its photo",
            where=record.path,
            expected=f"{image.colour.shape[1]} x {image.colour.shape[0]}",
            got=f"{mask.shape[1]} x {mask.shape[0]}",
        )
    return mask if within is None else mask & within


def box_outline(camera: Camera, bounds: Floats) -> Bools:
    """Pixels in which a box may appear: the convex hull of its corners, (height, width).

    All of them where the box reaches behind the camera.
    """
    pixels = camera.project(np.where(SIGNS < 0.0, bounds[0], bounds[1]))
    if not np.isfinite(pixels).all():
        return np.ones((camera.height, camera.width), dtype=bool)
    from scipy.spatial import ConvexHull  # noqa: PLC0415 - used here only
    from skimage.draw import polygon2mask  # noqa: PLC0415 - scikit-image takes 0.3 s

    hull = pixels[ConvexHull(pixels).vertices]
    # polygon2mask counts rows first and has the middle of the first pixel at 0.
    outline = polygon2mask((camera.height, camera.width), hull[:, ::-1] - 0.5)
    return np.asarray(outline, dtype=bool)


def _mask_file(folder: Path, record: PhotoRecord) -> Path:
    """Mask of a photo: its name, or its name with .png for the extension or after it."""
    name = Path(record.name)
    candidates = [folder / name, folder / name.with_suffix(".png"), folder / f"{name}.png"]
    candidates += [folder / candidate.name for candidate in candidates]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise UserError(what="no mask for this photo", where=folder, expected=candidates[1].name)
