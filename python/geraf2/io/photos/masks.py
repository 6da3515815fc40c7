"""Masks of an object before a dark background."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

# Single bright pixels of noise make no object, and the outline moves by less than half a pixel.
_BLUR_PIXELS = 1.0


def threshold_mask(
    image: NDArray[np.uint8], threshold: float, within: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """Largest connected part whose brightest channel, blurred by one pixel, is above a threshold.

    Parameters
    ----------
    image
        (height, width, 3), sRGB.
    threshold
        Brightness of the background at most, 0 to 255.
    within
        Where the object may be at all, (height, width); None: anywhere.

    Returns
    -------
    (height, width), True where the object is; holes stay holes. All False where nothing is bright.
    """
    brightness = ndimage.gaussian_filter(image.max(axis=2).astype(np.float32), _BLUR_PIXELS)
    bright = brightness > threshold
    labels, n_parts = ndimage.label(bright if within is None else bright & within)
    if n_parts == 0:
        return np.zeros(labels.shape, dtype=bool)
    areas = np.bincount(labels.ravel())
    areas[0] = 0
    return np.asarray(labels == areas.argmax())
