"""Display colours: of a surface its expected error; sRGB and linear light."""

import numpy as np

from geraf2._types import Array, Bytes, Floats

WORST_SHOWN_M = 0.005
"""Expected error at the dark end of the colours of files, which begin at 0 [m]."""

ERROR_COLOURS = (
    "#a9ccd9",
    "#bfbaac",
    "#cda782",
    "#d69259",
    "#cd6a32",
    "#aa3d21",
    "#7d281f",
    "#531c1e",
)
"""Errors as colour: from a quiet blue (none) over sand and orange to dark red (WORST_SHOWN_M and
more). Equal steps of 20 in CIELAB; lightness falls for all kinds of colour vision."""
_CHANNELS = np.array([list(bytes.fromhex(c[1:])) for c in ERROR_COLOURS], dtype=np.float64)
_PLAIN_COLOUR = (190, 190, 190)


def worst_shown_m(expected_error_m: Floats) -> float:
    """Find the expected error at the dark end of a page's colours [m].

    95 % of the surface lies below. Whole millimetres, and at least `WORST_SHOWN_M`: good scans look
    alike.
    """
    return max(WORST_SHOWN_M, 1e-3 * float(np.ceil(1e3 * np.quantile(expected_error_m, 0.95))))


def error_colours(expected_error_m: Floats | None, n: int) -> Bytes:
    """Display colour of each vertex, sRGB, (n, 3): by the expected error, grey without one."""
    if expected_error_m is None:
        return np.tile(np.array(_PLAIN_COLOUR, dtype=np.uint8), (n, 1))
    steps = np.linspace(0.0, WORST_SHOWN_M, len(ERROR_COLOURS))
    channels = [np.interp(expected_error_m, steps, _CHANNELS[:, c]) for c in range(3)]
    return np.asarray(np.rint(np.stack(channels, axis=1)), dtype=np.uint8)


def to_linear(srgb: Array) -> Array:
    """Linear light of sRGB values, both 0 to 1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: Array) -> Array:
    """Return the inverse of `to_linear`."""
    return np.where(
        linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 0.0) ** (1 / 2.4) - 0.055
    )
