"""Masks of an object before a dark background."""

import numpy as np
from scipy import ndimage

from geraf2._types import Bools, Bytes, Floats32

# Removes single bright pixels of noise; the outline moves by less than half a pixel.
_BLUR_PIXELS = 1.0
_CRACK_RADIUS = 1 / 200
"""Radius of the disc that closes cracks, over the image's larger side: 3 pixels of 640."""
_HOLE_RADIUS = 1 / 64
"""Largest disc that an enclosed hole may hold and be shadow, likewise: 10 pixels of 640."""


def threshold_mask(
    image: Bytes, threshold: float, within: Bools | None = None, *, fill_shadows: bool = True
) -> Bools:
    """Largest connected part whose brightest channel, blurred by one pixel, is above a threshold.

    image: (height, width, 3), sRGB.
    threshold: brightness of the background at most, 0 to 255.
    within: pixels in which the object may be, (height, width); None: anywhere.
    fill_shadows: fill cracks that a disc of 1/200 of the larger side closes, and enclosed holes
        that hold no disc of 1/64 of it, where they are nearer to the threshold than to the
        background. A gap that shows the background stays.

    Returns (height, width); all False where nothing is bright.
    """
    brightness = ndimage.gaussian_filter(image.max(axis=2).astype(np.float32), _BLUR_PIXELS)
    bright = brightness > threshold
    labels, n_parts = ndimage.label(bright if within is None else bright & within)
    if n_parts == 0:
        return np.zeros(labels.shape, dtype=bool)
    areas = np.bincount(labels.ravel())
    areas[0] = 0
    mask = np.asarray(labels == areas.argmax())
    return mask | _shadows(mask, brightness, threshold) if fill_shadows else mask


def close_cracks(mask: Bools) -> Bools:
    """Silhouette without cracks: morphological closing by a disc of 1/200 of the larger side."""
    radius = _CRACK_RADIUS * max(mask.shape)
    margin = int(np.ceil(radius)) + 1
    padded = np.pad(mask, margin)
    if not padded.any():
        return mask
    grown = ndimage.distance_transform_edt(~padded) <= radius
    closed = ndimage.distance_transform_edt(grown) > radius
    inner = closed[margin:-margin, margin:-margin]
    return np.asarray(inner | mask)


def _shadows(mask: Bools, brightness: Floats32, threshold: float) -> Bools:
    """Cracks and small holes of a silhouette that are brighter than the background around it."""
    outside = ~ndimage.binary_fill_holes(mask)
    if not outside.any():
        return np.zeros_like(mask)
    lit = 0.5 * (threshold + float(np.median(brightness[outside])))
    closed = close_cracks(mask)
    holes, n_holes = ndimage.label(~closed & ~outside)
    depth = ndimage.distance_transform_edt(~closed)
    widest = ndimage.maximum(depth, holes, np.arange(1, n_holes + 1))
    small = np.concatenate([[False], np.asarray(widest) <= _HOLE_RADIUS * max(mask.shape)])
    # a hole and the cracks that lead to it are one dark region
    dark, n_dark = ndimage.label((closed | small[holes]) & ~mask)
    medians = ndimage.median(brightness, dark, np.arange(1, n_dark + 1))
    return np.asarray(np.concatenate([[False], np.asarray(medians) > lit])[dark])
