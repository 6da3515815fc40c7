"""Procedural textures: a printed and taped carton, the board it stands on, the table below.

Albedo in linear light. Every texture is a function of its size and a seed.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from geraf2._types import Bools

_Image = NDArray[np.float32]

_CARDBOARD = (0.50, 0.33, 0.19)
_INK = (0.05, 0.045, 0.05)
_RED_INK = (0.42, 0.06, 0.04)
_LABEL = (0.78, 0.77, 0.74)
_TAPE = (0.36, 0.21, 0.09)
_TAPE_OPACITY = 0.55
_TAPE_WIDTH_M = 0.05
_SOFT_TEXELS = 3
_COARSE_BLUR_TEXELS = 3.0
"""Noise with a wider blur is drawn on a raster so coarse that its blur is this wide."""
_FLUTE_M = 0.0075
"""Pitch of C flute, which shows through the liner."""
_WOOD = (0.32, 0.26, 0.20)
_TABLE = (0.22, 0.24, 0.25)
_MARK = (0.75, 0.70, 0.15)


class Texture(NamedTuple):
    """Appearance of a flat surface; rows downwards, columns to the right seen from outside."""

    albedo: _Image
    """(rows, columns, 3), linear."""
    gloss: _Image
    """Strength of the highlight, (rows, columns)."""


class _Canvas:
    """A texture while it is drawn, in metres from its middle, x to the right and y up."""

    def __init__(self, width_m: float, height_m: float, texel_m: float) -> None:
        self.width_m, self.height_m, self.texel_m = width_m, height_m, texel_m
        columns = max(8, round(width_m / texel_m))
        rows = max(8, round(height_m / texel_m))
        x = ((np.arange(columns) + 0.5) / columns - 0.5) * width_m
        y = (0.5 - (np.arange(rows) + 0.5) / rows) * height_m
        self.x, self.y = x[None, :], y[:, None]
        self.albedo = np.zeros((rows, columns, 3), dtype=np.float32)
        self.gloss = np.zeros((rows, columns), dtype=np.float32)

    def noise(self, rng: np.random.Generator, blur_m: tuple[float, float]) -> _Image:
        """Smooth noise of unit variance; `blur_m` along y and x."""
        blur = [max(b / self.texel_m, 0.3) for b in blur_m]
        # Smooth noise is drawn on a coarser raster: fewer texels, narrower filters.
        coarse = [max(1.0, b / _COARSE_BLUR_TEXELS) for b in blur]
        rows, columns = self.gloss.shape
        small = (max(8, round(rows / coarse[0])), max(8, round(columns / coarse[1])))
        white = rng.standard_normal(small).astype(np.float32)
        sigma = (blur[0] * small[0] / rows, blur[1] * small[1] / columns)
        smooth = ndimage.gaussian_filter(white, sigma, mode="wrap", truncate=3.0)
        smooth /= max(float(smooth.std()), 1e-12)
        if small == self.gloss.shape:
            return np.asarray(smooth)
        return _stretch(_stretch(smooth, rows).T, columns).T

    def rectangle(self, left: float, bottom: float, width: float, height: float) -> Bools:
        """Texels inside a rectangle."""
        across = (self.x >= left) & (self.x < left + width)
        return np.asarray(across & (self.y >= bottom) & (self.y < bottom + height))

    def paint(self, where: Bools, colour: tuple[float, float, float], opacity: float = 0.9) -> None:
        """Blend a colour in, its edge softened by half a texel."""
        rows, columns = (np.flatnonzero(where.any(axis=axis)) for axis in (1, 0))
        if rows.size == 0:
            return
        part = (
            slice(max(rows[0] - _SOFT_TEXELS, 0), rows[-1] + 1 + _SOFT_TEXELS),
            slice(max(columns[0] - _SOFT_TEXELS, 0), columns[-1] + 1 + _SOFT_TEXELS),
        )
        cover = ndimage.gaussian_filter(where[part].astype(np.float32), 0.6) * np.float32(opacity)
        below = self.albedo[part]
        below += cover[:, :, None] * (np.asarray(colour, np.float32) - below)

    def texture(self) -> Texture:
        """Finished texture."""
        return Texture(np.clip(self.albedo, 0.01, 0.95), np.clip(self.gloss, 0.0, 1.0))


def carton_face(size_m: tuple[float, float], seed: int, *, side: int) -> Texture:
    """One face of a shipping carton.

    size_m: width and height of the face [m].
    seed: of fibres, print and wear.
    side: 0 to 3: side faces, which are printed differently; 4: top and 5: bottom, taped along x.
    """
    rng = np.random.default_rng([seed, side])
    canvas = _Canvas(*size_m, 0.0004)
    _cardboard(canvas, rng)
    print_on = (_print_front, _print_label, _print_front, _print_symbols)
    if side < 4:
        print_on[side](canvas, rng)
        if side in (0, 2):
            _tape_down(canvas)
    else:
        _print_stamps(canvas, rng)
        _tape_across(canvas)
    _wear(canvas, rng)
    return canvas.texture()


def board(side_m: float, seed: int) -> Texture:
    """Wooden board with a circle of marks, as turntables have, around its middle."""
    rng = np.random.default_rng([seed, 10])
    canvas = _Canvas(side_m, side_m, 0.001)
    grain = canvas.noise(rng, (0.002, 0.08))
    knots = canvas.noise(rng, (0.03, 0.06))
    brightness = 1.0 + 0.13 * grain + 0.10 * knots + 0.05 * canvas.noise(rng, (0.001, 0.001))
    canvas.albedo[:] = np.asarray(_WOOD, np.float32) * np.maximum(brightness, 0.2)[:, :, None]
    radius = np.hypot(canvas.x, canvas.y)
    angle = np.degrees(np.arctan2(canvas.y, canvas.x)) % 360.0
    rim = 0.46 * side_m
    canvas.paint(np.abs(radius - rim) < 0.0015, _MARK)
    for step, length in ((10.0, 0.012), (30.0, 0.022)):
        off = np.abs((angle + 0.5 * step) % step - 0.5 * step)
        near = np.radians(off) * radius < 0.001
        canvas.paint(near & (radius < rim) & (radius > rim - length), _MARK)
    return canvas.texture()


def table(side_m: float, seed: int) -> Texture:
    """Speckled table top."""
    rng = np.random.default_rng([seed, 11])
    canvas = _Canvas(side_m, side_m, 0.005)
    cloud = canvas.noise(rng, (0.15, 0.15)) + 0.6 * canvas.noise(rng, (0.02, 0.02))
    brightness = np.maximum(1.0 + 0.14 * cloud, 0.2)
    canvas.albedo[:] = np.asarray(_TABLE, np.float32) * brightness[:, :, None]
    return canvas.texture()


def _stretch(image: _Image, n_rows: int) -> _Image:
    """Rows of an image by linear interpolation, periodic."""
    position = (np.arange(n_rows) + 0.5) * image.shape[0] / n_rows - 0.5
    first = np.floor(position).astype(int)
    share = (position - first).astype(np.float32)[:, None]
    near, next_one = image[first % image.shape[0]], image[(first + 1) % image.shape[0]]
    return np.asarray(near * (1.0 - share) + next_one * share, dtype=np.float32)


def _cardboard(canvas: _Canvas, rng: np.random.Generator) -> None:
    fibres = canvas.noise(rng, (0.0004, 0.004)) + canvas.noise(rng, (0.004, 0.0005))
    blotches = canvas.noise(rng, (0.02, 0.025))
    flutes = np.sin(2.0 * np.pi * canvas.x / _FLUTE_M) * np.ones_like(canvas.y)
    brightness = 1.0 + 0.055 * fibres + 0.06 * blotches + 0.03 * flutes.astype(np.float32)
    specks = canvas.noise(rng, (0.0005, 0.0005)) > 2.6
    canvas.albedo[:] = np.asarray(_CARDBOARD, np.float32) * brightness[:, :, None]
    canvas.albedo[:, :, 2] *= 1.0 - 0.05 * canvas.noise(rng, (0.03, 0.03))
    canvas.paint(specks, (0.25, 0.16, 0.09), 0.6)
    canvas.gloss[:] = 0.02


def _text(
    canvas: _Canvas,
    rng: np.random.Generator,
    box: tuple[float, float, float, float],
    n_lines: int,
    colour: tuple[float, float, float] = _INK,
) -> None:
    """Lines of glyphs of 5 x 7 random cells in a box (left, bottom, width, height)."""
    left, bottom, width, height = box
    pitch = height / n_lines
    cell = 0.7 * pitch / 7.0
    column = np.floor((canvas.x - left) / cell).astype(int)
    for line in range(n_lines):
        base = bottom + height - (line + 1) * pitch
        row = np.floor((canvas.y - base) / cell).astype(int)
        n_glyphs = max(1, int(width * rng.uniform(0.6, 1.0) / (6.0 * cell)))
        # A border cell stays empty between glyphs, a glyph now and then between words.
        dots = rng.random((7, n_glyphs, 6)) < 0.55
        dots[:, :, 5] = False
        dots[:, rng.random(n_glyphs) < 0.15] = False
        dots = dots.reshape(7, -1)
        known = (column >= 0) & (column < dots.shape[1]) & (row >= 0) & (row < 7)
        where = known & dots[np.clip(row, 0, 6), np.clip(column, 0, dots.shape[1] - 1)]
        canvas.paint(np.asarray(where), colour)


def _bars(
    canvas: _Canvas, rng: np.random.Generator, box: tuple[float, float, float, float]
) -> None:
    """Bar code in a box (left, bottom, width, height)."""
    left, width = box[0], box[2]
    n_bars = max(8, int(width / 0.0009))
    dark = rng.random(n_bars) < 0.5
    index = np.clip(((canvas.x - left) / width * n_bars).astype(int), 0, n_bars - 1)
    canvas.paint(canvas.rectangle(*box) & dark[index], _INK)


def _arrow_up(canvas: _Canvas, x: float, y: float, size: float) -> None:
    """This-side-up arrow, its foot at (x, y)."""
    dx, dy = np.abs(canvas.x - x), canvas.y - y
    shaft = (dx < 0.16 * size) & (dy > 0) & (dy < 0.6 * size)
    head = (dy >= 0.55 * size) & (dx < 0.9 * (size - dy))
    canvas.paint(np.asarray(shaft | head), _INK)


def _print_front(canvas: _Canvas, rng: np.random.Generator) -> None:
    """Emblem of rings, a name, small print."""
    w, h = canvas.width_m, canvas.height_m
    s = min(w, h)
    radius = np.hypot(canvas.x + 0.22 * w, canvas.y - 0.02 * h)
    canvas.paint((radius < 0.16 * s) & (radius > 0.125 * s), _RED_INK)
    canvas.paint(radius < 0.07 * s, _RED_INK)
    _text(canvas, rng, (0.0, -0.06 * h, 0.40 * w, 0.20 * h), 2, _RED_INK)
    _text(canvas, rng, (-0.42 * w, -0.42 * h, 0.55 * w, 0.17 * h), 5)
    _bars(canvas, rng, (0.17 * w, -0.40 * h, 0.25 * w, 0.13 * h))


def _print_label(canvas: _Canvas, rng: np.random.Generator) -> None:
    """Glued white shipping label, arrows beside it."""
    w, h = canvas.width_m, canvas.height_m
    label = (-0.40 * w, -0.22 * h, 0.55 * w, 0.56 * h)
    canvas.paint(canvas.rectangle(*label), _LABEL, 1.0)
    canvas.gloss[canvas.rectangle(*label)] = 0.08
    _text(canvas, rng, (-0.37 * w, 0.10 * h, 0.45 * w, 0.20 * h), 4)
    _bars(canvas, rng, (-0.37 * w, -0.18 * h, 0.48 * w, 0.16 * h))
    canvas.paint(canvas.rectangle(-0.40 * w, 0.05 * h, 0.55 * w, 0.008 * h), _INK)
    _arrow_up(canvas, 0.26 * w, 0.05 * h, 0.25 * h)
    _arrow_up(canvas, 0.38 * w, 0.05 * h, 0.25 * h)
    _text(canvas, rng, (0.18 * w, -0.40 * h, 0.27 * w, 0.10 * h), 2)


def _print_symbols(canvas: _Canvas, rng: np.random.Generator) -> None:
    """Arrows, a glass, a frame, a block of text."""
    w, h = canvas.width_m, canvas.height_m
    for x in (-0.36 * w, -0.24 * w):
        _arrow_up(canvas, x, 0.05 * h, 0.26 * h)
    canvas.paint(canvas.rectangle(-0.43 * w, -0.01 * h, 0.26 * w, 0.02 * h), _INK)
    dx, dy = np.abs(canvas.x - 0.05 * w), canvas.y - 0.02 * h
    bowl = (dy > 0.12 * h) & (dy < 0.32 * h) & (dx < 0.05 * w + 0.12 * (dy - 0.12 * h))
    stem = (dx < 0.008 * w) & (dy > 0.0) & (dy < 0.14 * h)
    foot = (dx < 0.06 * w) & (dy > -0.015 * h) & (dy < 0.01 * h)
    canvas.paint(np.asarray(bowl | stem | foot), _INK)
    outer = canvas.rectangle(0.17 * w, 0.02 * h, 0.26 * w, 0.33 * h)
    inner = canvas.rectangle(0.185 * w, 0.035 * h, 0.23 * w, 0.30 * h)
    canvas.paint(outer & ~inner, _RED_INK)
    _text(canvas, rng, (0.20 * w, 0.05 * h, 0.21 * w, 0.27 * h), 4, _RED_INK)
    _text(canvas, rng, (-0.42 * w, -0.42 * h, 0.84 * w, 0.30 * h), 6)


def _print_stamps(canvas: _Canvas, rng: np.random.Generator) -> None:
    """Small print on both sides of the tape."""
    w, h = canvas.width_m, canvas.height_m
    _text(canvas, rng, (-0.40 * w, 0.20 * h, 0.45 * w, 0.14 * h), 3)
    _text(canvas, rng, (0.02 * w, -0.36 * h, 0.40 * w, 0.12 * h), 2, _RED_INK)
    _bars(canvas, rng, (-0.38 * w, -0.40 * h, 0.22 * w, 0.14 * h))


def _tape_across(canvas: _Canvas) -> None:
    """Seam between the flaps along x, and the tape over it."""
    canvas.paint(np.abs(canvas.y) + 0.0 * canvas.x < 0.0006, (0.08, 0.05, 0.03))
    _tape(canvas, np.abs(canvas.y) + 0.0 * canvas.x < 0.5 * _TAPE_WIDTH_M)


def _tape_down(canvas: _Canvas) -> None:
    """Paint the ends of the tape on a side: a fifth of it from the top and from below."""
    # The tape of top and bottom runs along x, so it comes down the faces across x, in their middle.
    reach = 0.5 * canvas.height_m - 0.22 * canvas.height_m
    _tape(canvas, (np.abs(canvas.x) < 0.5 * _TAPE_WIDTH_M) & (np.abs(canvas.y) > reach))


def _tape(canvas: _Canvas, where: Bools) -> None:
    canvas.paint(where, _TAPE, _TAPE_OPACITY)
    rim = where & ~ndimage.binary_erosion(where, iterations=2, border_value=1)
    canvas.paint(rim, (0.55, 0.42, 0.28), 0.35)
    canvas.gloss[where] = 0.25


def _wear(canvas: _Canvas, rng: np.random.Generator) -> None:
    """Rubbed edges."""
    to_edge = np.minimum(
        0.5 * canvas.width_m - np.abs(canvas.x), 0.5 * canvas.height_m - np.abs(canvas.y)
    )
    rubbed = np.exp(-to_edge / 0.003) * (0.35 + 0.2 * canvas.noise(rng, (0.004, 0.004)))
    canvas.albedo *= 1.0 + np.clip(rubbed, -0.3, 0.6)[:, :, None].astype(np.float32)
