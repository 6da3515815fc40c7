import enum
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

_Complex = TypeVar("_Complex", np.complex64, np.complex128)
_Real = TypeVar("_Real", np.float32, np.float64)

class EmbreeError(RuntimeError): ...

def embree_major() -> int: ...
def simd_level() -> str: ...
def max_threads() -> int: ...

class PairModel:
    def __init__(
        self,
        *,
        reach: float,
        least_cosine: float,
        spread: float,
        offset_variance: float,
        bend: float,
        turn_variance: float,
        curvature: float,
        least_density: float,
    ) -> None: ...

def pair_densities(
    positions: NDArray[np.float64],
    normals: NDArray[np.float64],
    planes: NDArray[np.int64],
    subapertures: NDArray[np.int64],
    other_positions: NDArray[np.float64],
    other_normals: NDArray[np.float64],
    other_planes: NDArray[np.int64],
    other_subapertures: NDArray[np.int64],
    model: PairModel,
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int64]]: ...

class _GridEnergy(Generic[_Real]):
    def __init__(
        self,
        shape: tuple[int, int, int],
        spacing: tuple[float, float, float],
        bending: float,
        rows: NDArray[np.int64],
        starts: NDArray[np.int64],
        columns: NDArray[np.int32],
        values: NDArray[np.float64],
        diagonal: NDArray[np.float64],
    ) -> None: ...
    def apply(self, field: NDArray[_Real], num_threads: int) -> NDArray[_Real]: ...
    def diagonal(self, n_voxels: int) -> NDArray[_Real]: ...
    def smooth(
        self,
        right: NDArray[_Real],
        field: NDArray[_Real],
        degree: int,
        low: float,
        high: float,
        num_threads: int,
    ) -> NDArray[_Real]: ...

class GridEnergyFloat(_GridEnergy[np.float32]): ...
class GridEnergyDouble(_GridEnergy[np.float64]): ...

class MeshScene:
    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None: ...
    def closest_hit(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64], num_threads: int
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]: ...
    def first_meetings(
        self, origins: NDArray[np.float64], targets: NDArray[np.float64], num_threads: int
    ) -> NDArray[np.float64]: ...
    def spans(
        self,
        origins: NDArray[np.float64],
        directions: NDArray[np.float64],
        wound_outward: bool,
        num_threads: int,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...
    def occluded(
        self,
        origins: NDArray[np.float64],
        targets: NDArray[np.float64],
        margin_m: float,
        num_threads: int,
    ) -> NDArray[np.uint8]: ...
    def crossings(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64], num_threads: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.uint8]]: ...
    def distance(self, points: NDArray[np.float64], num_threads: int) -> NDArray[np.float64]: ...
    def signed_distance(
        self, points: NDArray[np.float64], num_threads: int
    ) -> NDArray[np.float64]: ...
    def contains(self, points: NDArray[np.float64], num_threads: int) -> NDArray[np.uint8]: ...
    def winding_number(
        self, points: NDArray[np.float64], num_threads: int
    ) -> NDArray[np.float64]: ...

class Waveform:
    def __init__(
        self,
        start_frequency_hz: float,
        chirp_slope_hz_per_s: float,
        sample_rate_hz: float,
        n_samples: int,
        path_bias_m: float,
    ) -> None: ...

class VoxelGrid:
    def __init__(self, origin: Sequence[float], spacing: float, shape: Sequence[int]) -> None: ...

class MatchedFilterMethod(enum.Enum):
    automatic = 0
    exact = 1
    block = 2
    factorised = 3

class MatchedFilterOptions:
    def __init__(
        self,
        method: MatchedFilterMethod,
        rtol: float,
        num_threads: int,
        max_memory_bytes: float,
    ) -> None: ...

class MatchedFilterChoice:
    @property
    def method(self) -> MatchedFilterMethod: ...
    @property
    def exact_cost(self) -> float: ...
    @property
    def block_cost(self) -> float: ...
    @property
    def factorised_cost(self) -> float: ...
    @property
    def exact_share(self) -> float: ...
    @property
    def block_share(self) -> float: ...

class _MatchedFilterPlan(Generic[_Complex]):
    def __init__(
        self,
        tx: NDArray[np.float64],
        rx: NDArray[np.float64],
        points: NDArray[np.float64] | VoxelGrid,
        waveform: Waveform,
        options: MatchedFilterOptions,
    ) -> None: ...
    def image(
        self, signal: NDArray[_Complex], progress: Callable[[float], None] | None
    ) -> NDArray[_Complex]: ...
    def adjoint(self, image: NDArray[_Complex]) -> NDArray[_Complex]: ...

class MatchedFilterPlanFloat(_MatchedFilterPlan[np.complex64]): ...
class MatchedFilterPlanDouble(_MatchedFilterPlan[np.complex128]): ...

def choose_matched_filter_float32(
    tx: NDArray[np.float64],
    rx: NDArray[np.float64],
    points: NDArray[np.float64] | VoxelGrid,
    waveform: Waveform,
    options: MatchedFilterOptions,
) -> MatchedFilterChoice: ...
def choose_matched_filter_float64(
    tx: NDArray[np.float64],
    rx: NDArray[np.float64],
    points: NDArray[np.float64] | VoxelGrid,
    waveform: Waveform,
    options: MatchedFilterOptions,
) -> MatchedFilterChoice: ...
def matched_filter_bwd_positions(
    image_grad: NDArray[_Complex],
    signal: NDArray[_Complex],
    tx: NDArray[np.float64],
    rx: NDArray[np.float64],
    points: NDArray[np.float64] | VoxelGrid,
    waveform: Waveform,
    num_threads: int,
    want_antennas: bool,
    want_points: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...
def point_images_fwd(
    signals: NDArray[_Complex],
    tx: NDArray[np.float64],
    rx: NDArray[np.float64],
    points: NDArray[np.float64],
    waveform: Waveform,
    num_threads: int,
) -> NDArray[_Complex]: ...
def point_images_bwd(
    images: NDArray[_Complex],
    tx: NDArray[np.float64],
    rx: NDArray[np.float64],
    points: NDArray[np.float64],
    waveform: Waveform,
    num_threads: int,
) -> NDArray[_Complex]: ...

class ElementShape(enum.Enum):
    point = 0
    triangle = 1
    rectangle = 2

class Reflector(enum.Enum):
    conductor = 0
    slab = 1

class EchoParams:
    shape: ElementShape
    reflector: Reflector
    slab_permittivity: float
    slab_crossing: float
    slab_thickness_m: float
    pattern_exponent: int
    boresight: tuple[float, ...]
    def __init__(self, waveform: Waveform) -> None: ...

def physical_optics(
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    edges: NDArray[np.float64],
    weights: NDArray[_Complex],
    tx: NDArray[np.float64],
    rx: NDArray[np.float64],
    block_offsets: NDArray[np.int64],
    walls: NDArray[np.float64],
    params: EchoParams,
    num_threads: int,
) -> NDArray[_Complex]: ...

class CosineAxis:
    def __init__(self, count: int, first: float, pitch: float, wraps: bool) -> None: ...

class RangeAxis:
    def __init__(self, count: int, first_m: float, pitch_m: float) -> None: ...

class SubapertureBins:
    def __init__(self, horizontal: CosineAxis, vertical: CosineAxis, ranges: RangeAxis) -> None: ...

class SubapertureLattice:
    def __init__(
        self,
        n_horizontal: int,
        n_vertical: int,
        horizontal_spacing_m: float,
        vertical_spacing_m: float,
        spread_width: int,
        spread_exponent: float,
    ) -> None: ...

class PeakThresholds:
    def __init__(self, dynamic_range: float, noise_margin: float) -> None: ...

class SubapertureMembers:
    def __init__(
        self,
        offsets: NDArray[np.int64],
        antennas: NDArray[np.int64],
        weights: NDArray[np.float64],
        positions: NDArray[np.float64],
        focus: NDArray[np.float64],
        focus_range_m: NDArray[np.float64],
    ) -> None: ...

_Peaks: TypeAlias = tuple[
    NDArray[np.int64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
]

def subaperture_images(
    signal: NDArray[Any],
    tx: NDArray[np.float64],
    rx: NDArray[np.float64],
    waveform: Waveform,
    members: SubapertureMembers,
    lattice: SubapertureLattice,
    bins: SubapertureBins,
    num_threads: int,
) -> NDArray[Any]: ...
def subaperture_peaks(
    signal: NDArray[Any],
    tx: NDArray[np.float64],
    rx: NDArray[np.float64],
    waveform: Waveform,
    members: SubapertureMembers,
    lattice: SubapertureLattice,
    bins: SubapertureBins,
    thresholds: PeakThresholds,
    num_threads: int,
) -> _Peaks: ...
def image_peaks(
    magnitudes: NDArray[Any], bins: SubapertureBins, thresholds: PeakThresholds
) -> _Peaks: ...
def noise_floor(magnitudes: NDArray[Any], bins: SubapertureBins) -> NDArray[np.float64]: ...
def signal_tracer_fwd(
    amplitude: NDArray[_Real],
    points: NDArray[np.float64],
    normals: NDArray[_Real],
    tx: NDArray[np.float64],
    rx: NDArray[np.float64],
    waveform: Waveform,
    rtol: float,
    num_threads: int,
) -> NDArray[np.complexfloating]: ...
def signal_tracer_bwd(
    signal_grad: NDArray[np.complexfloating],
    amplitude: NDArray[_Real],
    points: NDArray[np.float64],
    normals: NDArray[_Real],
    tx: NDArray[np.float64],
    rx: NDArray[np.float64],
    waveform: Waveform,
    rtol: float,
    num_threads: int,
    want_amplitude: bool,
    want_normals: bool,
    want_points: bool,
    want_antennas: bool,
) -> tuple[
    NDArray[_Real],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
    NDArray[np.float64],
]: ...
def ray_intervals_float32(
    origins: NDArray[np.float64],
    direction: NDArray[np.float64],
    near: NDArray[np.float64],
    far: NDArray[np.float64],
    jitter: NDArray[np.float64],
    num_threads: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]: ...
def ray_intervals_float64(
    origins: NDArray[np.float64],
    direction: NDArray[np.float64],
    near: NDArray[np.float64],
    far: NDArray[np.float64],
    jitter: NDArray[np.float64],
    num_threads: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...
def length_defect(gradients: NDArray[_Real], num_threads: int) -> tuple[float, NDArray[_Real]]: ...
def facing_samples(
    alpha: NDArray[_Real],
    gradient: NDArray[_Real],
    points: NDArray[np.float64],
    centers: NDArray[np.float64],
    has_lobe: bool,
    samples_per_ray: int,
    n_looks: int,
    num_threads: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]: ...
def echo_amplitudes_fwd(
    alpha: NDArray[_Real],
    transmittance: NDArray[_Real],
    gradient: NDArray[_Real],
    points: NDArray[np.float64],
    sample: NDArray[np.int64],
    offsets: NDArray[np.int64],
    n_looks: int,
    shift: NDArray[_Real],
    centers: NDArray[np.float64],
    references: NDArray[np.float64],
    lobe_power: float,
    two_way_power: int,
    num_threads: int,
) -> tuple[NDArray[_Real], NDArray[_Real], NDArray[_Real]]: ...
def echo_amplitudes_bwd(
    alpha: NDArray[_Real],
    transmittance: NDArray[_Real],
    gradient: NDArray[_Real],
    points: NDArray[np.float64],
    sample: NDArray[np.int64],
    offsets: NDArray[np.int64],
    n_looks: int,
    shift: NDArray[_Real],
    centers: NDArray[np.float64],
    references: NDArray[np.float64],
    lobe_power: float,
    two_way_power: int,
    factor: NDArray[_Real],
    amplitude_grad: NDArray[_Real],
    normals_grad: NDArray[_Real],
    want_gradient: bool,
) -> tuple[NDArray[_Real], NDArray[_Real], NDArray[_Real]]: ...
def trace_parts_fwd(
    amplitude: NDArray[_Real],
    points: NDArray[np.float64],
    normals: NDArray[_Real],
    tx: NDArray[np.float64],
    rx: NDArray[np.float64],
    offsets: NDArray[np.int64],
    order: NDArray[np.int64],
    groups: NDArray[np.int64],
    waveform: Waveform,
    rtol: float,
    num_threads: int,
) -> NDArray[np.complexfloating]: ...
def trace_parts_bwd(
    signal_grad: NDArray[np.complexfloating],
    amplitude: NDArray[_Real],
    points: NDArray[np.float64],
    normals: NDArray[_Real],
    tx: NDArray[np.float64],
    rx: NDArray[np.float64],
    offsets: NDArray[np.int64],
    order: NDArray[np.int64],
    groups: NDArray[np.int64],
    waveform: Waveform,
    rtol: float,
    num_threads: int,
    want_amplitude: bool,
    want_normals: bool,
) -> tuple[NDArray[_Real], NDArray[np.float64]]: ...
def ray_march_fwd(
    sdf: NDArray[_Real],
    cos: NDArray[_Real],
    step: NDArray[_Real],
    inv_s: float,
    power: int,
    num_threads: int,
) -> tuple[NDArray[_Real], NDArray[_Real], NDArray[_Real], NDArray[_Real]]: ...
def ray_march_bwd(
    sdf: NDArray[_Real],
    cos: NDArray[_Real],
    step: NDArray[_Real],
    inv_s: float,
    power: int,
    alpha: NDArray[_Real],
    transmittance: NDArray[_Real],
    alpha_grad: NDArray[_Real],
    transmittance_grad: NDArray[_Real],
    weight_grad: NDArray[_Real],
    depth_grad: NDArray[_Real],
    num_threads: int,
) -> tuple[NDArray[_Real], NDArray[_Real], float]: ...
def sdf_grid_fwd(
    values: NDArray[_Real],
    grid: VoxelGrid,
    points: NDArray[np.float64],
    cubic: bool,
    want_hessian: bool,
    num_threads: int,
) -> tuple[NDArray[_Real], NDArray[_Real], NDArray[_Real]]: ...
def sdf_grid_bwd(
    value_grad: NDArray[_Real],
    gradient_grad: NDArray[_Real],
    grid: VoxelGrid,
    points: NDArray[np.float64],
    cubic: bool,
    num_threads: int,
) -> NDArray[_Real]: ...
