"""Physical-optics echo of surface elements, seen through dielectric walls."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from geraf2 import _core  # noqa: TID251 - ops is the package that wraps the native module
from geraf2._types import Floats, Ints
from geraf2._validation import require_shape
from geraf2.ops._geometry import native_waveform, require_positions
from geraf2.ops._threads import resolve_num_threads
from geraf2.scene import Wall, Waveform

_MAX_EXPONENT = 100


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceElements:
    """Small pieces of surface (or points) and what they are made of."""

    points: Floats
    """Centroids, (n_points, 3) [m]."""
    normals: Floats | None = None
    """Unit normals; an element is lit from this side only. None: points without a side."""
    edges: Floats | None = None
    """(n_points, 2, 3) [m]: two corners seen from the centroid (triangle) or both half sides."""
    shape: Literal["point", "triangle", "rectangle"] = "point"
    """What `edges` describe; the phase varies linearly over an element."""
    reflector: Literal["conductor", "slab"] = "conductor"
    """Reflection: -1, or both faces of a dielectric slab, r and -r (1 - r^2)."""
    slab: Wall | None = None
    """Permittivity and thickness of the slab; needed unless a conductor."""
    slab_crossing: float = 1.0
    """Amplitude that one crossing of the slab leaves, beside the reflection of its faces."""

    def __post_init__(self) -> None:
        n_points = self.points.shape[0]
        require_shape("points", self.points, (None, 3))
        if self.normals is not None:
            require_shape("normals", self.normals, (n_points, 3))
        if self.shape != "point":
            edges = np.empty(0) if self.edges is None else self.edges
            require_shape("edges", edges, (n_points, 2, 3))
        if self.reflector != "conductor" and (self.slab is None or self.normals is None):
            msg = f"reflector {self.reflector!r} needs slab and normals, got none"
            raise ValueError(msg)


@dataclass(frozen=True, kw_only=True, eq=False)
class AntennaBlocks:
    """Antennas of one pose, neighbours after another; weights are given per block."""

    tx: Floats
    """(n_antennas, 3) [m]."""
    rx: Floats
    """(n_antennas, 3) [m]."""
    offsets: Ints
    """Block b holds antennas offsets[b] to offsets[b + 1], (n_blocks + 1,)."""
    boresight: Floats
    """Viewing direction of the antennas, a unit vector (3,)."""
    pattern_exponent: int = 0
    """n of the amplitude pattern cos^n of each transmitter and receiver; 0 is isotropic."""

    def __post_init__(self) -> None:
        require_shape("tx", self.tx, (None, 3))
        require_shape("rx", self.rx, (self.tx.shape[0], 3))
        require_shape("offsets", self.offsets, (None,))
        require_shape("boresight", self.boresight, (3,))
        steps = np.diff(self.offsets)
        ends = (int(self.offsets[0]), int(self.offsets[-1])) if self.offsets.size else None
        if ends != (0, self.tx.shape[0]) or (steps < 0).any():
            msg = f"offsets must rise from 0 to {self.tx.shape[0]}, got ends {ends}"
            raise ValueError(msg)
        if not 0 <= self.pattern_exponent <= _MAX_EXPONENT:  # it is a loop
            msg = f"pattern_exponent must be 0 to {_MAX_EXPONENT}, got {self.pattern_exponent}"
            raise ValueError(msg)


def physical_optics(
    elements: SurfaceElements,
    weights: NDArray[np.complexfloating],
    antennas: AntennaBlocks,
    waveform: Waveform,
    *,
    walls: Sequence[Wall] = (),
    num_threads: int | None = None,
) -> NDArray[np.complexfloating]:
    """Echo of surface elements p at the antennas a of blocks b.

    s_a(t) = j / (4 pi) sum_p w_bp r T O g F / (R_t R_r) exp(-j 2 pi f_t (d + e) / c),
    d = R_t + R_r + path bias. O = (n . w_t + n . w_r) / 2 where both ends lie in front, else 0;
    r the reflection coefficient (conductor: -1), T and e transmission and excess path of the walls
    crossed, g the antenna pattern, F the form factor of a triangle or rectangle whose phase is
    linear. abs(s)^2 is received over transmitted power for antennas of unit gain.

    elements: where and what the elements are.
    weights: area [m^2] times visibility (0 hidden, 1 seen), (n_blocks, n_points). complex128: every
        term in float64. complex64: blocks of more than 32 antennas on a raster are interpolated
        where the echo is smooth, within 1e-3. Reference phases are float64 in both.
    antennas: transmitters, receivers and their blocks. A block should be small against the range (a
        tenth), since the triangle form factor is taken from its centre.
    walls: closed shells that rays cross [m], in any order; TE polarisation, no inner reflections.

    Returns signal, (n_antennas, n_samples), dtype of the weights. Not differentiable.

    Derived in docs/math/echo-models.md#physical-optics-echo.
    """
    weights = np.ascontiguousarray(weights)
    if weights.dtype not in (np.complex64, np.complex128):
        msg = f"weights must be complex64 or complex128, got {weights.dtype}"
        raise TypeError(msg)
    n_points = elements.points.shape[0]
    require_shape("weights", weights, (antennas.offsets.shape[0] - 1, n_points))
    params = _core.EchoParams(native_waveform(waveform))
    params.shape = getattr(_core.ElementShape, elements.shape)
    params.reflector = getattr(_core.Reflector, elements.reflector)
    if elements.slab is not None:
        params.slab_permittivity = elements.slab.permittivity
        params.slab_thickness_m = elements.slab.thickness_m
        params.slab_crossing = elements.slab_crossing
    params.boresight = tuple(float(v) for v in antennas.boresight)
    params.pattern_exponent = antennas.pattern_exponent
    no_rows = np.empty((0, 3))
    return _core.physical_optics(
        require_positions("points", elements.points),
        no_rows if elements.normals is None else _to_double(elements.normals),
        np.empty((0, 2, 3)) if elements.edges is None else _to_double(elements.edges),
        weights,
        require_positions("tx", antennas.tx),
        require_positions("rx", antennas.rx),
        np.ascontiguousarray(antennas.offsets, dtype=np.int64),
        _wall_rows(walls),
        params,
        resolve_num_threads(num_threads),
    )


def _to_double(values: NDArray[np.floating]) -> Floats:
    return np.ascontiguousarray(values, dtype=np.float64)


def _wall_rows(walls: Sequence[Wall]) -> Floats:
    rows = [
        [*w.center_m, *(0.5 * side for side in w.size_m), w.thickness_m, w.permittivity]
        for w in walls
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, 8)
