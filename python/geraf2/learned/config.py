"""Every choice of the paper's preset; what its text leaves open says so."""

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval, MinLen

from geraf2._bounds import Bounded, Count, CountOrZero, MarginM, NotNegative, Positive, Share
from geraf2.learned.rendering.config import LobePower, RenderConfig, Spreading, TwoWayForm

TRAINING_VERSION = 7
"""Raised when the same capture and settings train another field."""

FULL_RATE_STEPS = 3000
"""Of stage 1, up to which distance grids take the whole rate."""

Octaves = Annotated[float, Interval(ge=0, le=10)]
FieldKind = Literal["grid", "mlp", "mlp-grid"]
Start = Literal["vision", "nested", "ball"]
Region = Literal["scene", "content"]
SharpnessRule = Literal["scheduled", "learned"]
Device = Literal["auto", "cpu", "cuda"]


@dataclass(frozen=True, kw_only=True)
class StageConfig(Bounded):
    """One of the two stages."""

    n_steps: CountOrZero = 2000
    """Steps; the paper's 100,000 want a GPU."""
    rsdf_weight: NotNegative = 0.0
    """lambda_RSDF, weight of the depth alignment; 0 in stage 1."""
    train_reflectivity: bool = False
    """Whether reflectivity learns; else it stays 1."""
    shape_rate: Share = 1.0
    """Share of the distance's learning rate: below 1 where a stage refines what another found."""


@dataclass(frozen=True, kw_only=True)
class PaperConfig(RenderConfig):
    """Constants of `--preset paper`."""

    field: FieldKind = "grid"
    """"mlp": the paper's networks, 8 x 256, 10 octaves; "grid": the same distance on a finer and
    finer grid; "mlp-grid": that network, evaluated at the voxels of the grid once a step."""
    start: Start = "ball"
    """Open. "vision": f_v, negative in the whole box. "nested": section 4.1 with a ball. "ball"
    alone."""
    start_radius: Positive = 0.5
    """Open. Radius of that ball over the prior's smallest half side; training hardly grows it."""
    region: Region = "scene"
    """Open. What rays, targets and the distance cover: "scene", the box and its walls; "content",
    its inside, where the mesh may be (crop_m)."""
    mlp_fit_steps: CountOrZero = 400
    """Open. Steps in which the network is fitted to its start before it sees an echo."""
    octaves_start: Octaves = 3.0
    """Open. Octaves of the distance network's encoding that are open at the start; the others open
    one after another, evenly over stage 1."""
    octaves_end: Octaves = 10.0
    """Octaves that are open from the end of stage 1 on; the paper's 10."""
    grid_n: Annotated[tuple[Annotated[int, Interval(ge=3, le=2048)], ...], MinLen(1)] = (13, 25)
    """Open. Voxels along a side of the distance grid, one entry a level; levels share stage 1."""
    grid_smoothing: NotNegative = 0.0
    """Open. Standard deviation, in voxels, by which gradients to the grid are blurred; 0: none."""
    reflectivity_n: Annotated[int, Interval(ge=2, le=2048)] = 33
    """Open. Voxels along a side of the reflectivity grid."""
    sharpness: SharpnessRule = "scheduled"
    """Open. "scheduled": s grows geometrically over stage 1 and stays. "learned": as in NeuS."""
    inv_s_start: Positive = 60.0
    """Open. Sharpness s at the start [1/m]."""
    inv_s_end: Positive = 200.0
    """Open. Sharpness s from the end of stage 1 on [1/m], where scheduled."""
    n_cells: Annotated[int, Interval(ge=2, le=4096)] = 32
    """Cells along the side of the scene's disc: 804 rays."""
    n_samples: Annotated[int, Interval(ge=2, le=4096)] = 32
    """Samples of a ray."""
    n_antennas: Count = 256
    """Open. Most antennas of a plane in a step; few leave a pedestal of side lobes."""
    window_m: MarginM = 0.05
    """Open. Side of the square that they are drawn from [m]; 0: the whole plane."""
    bank: Count = 1
    """One part in `bank` of them is rendered, the rest remembered; 1 with a window."""
    n_planes: Count = 4
    """Open. Planes whose gradients a step takes the mean of, evenly spaced among all."""
    n_targets: Count = 512
    """Open. Places at which rendered and measured heat map are compared in a step."""
    bright_targets: Share = 0.25
    """Open. Share of them drawn where the plane's measured map is bright; the rest uniformly."""
    dark_plane: Share = 0.04
    """Open. A ray is dark where the plane's map stays below this share of its peak ..."""
    dark_scene: Share = 0.15
    """... and the map of all planes exceeds this share: dark rays are left out; 0 keeps all."""
    eikonal_weight: NotNegative = 0.1
    """lambda_GRAD."""
    charbonnier: Positive = 1e-3
    """Open. Width of the Charbonnier loss, in units of the planes' mean peak."""
    stage1: StageConfig = dataclasses.field(default_factory=StageConfig)
    """Shape, with reflectivity frozen at 1."""
    stage2: StageConfig = dataclasses.field(
        default_factory=lambda: StageConfig(n_steps=1000, rsdf_weight=1.0, train_reflectivity=True)
    )
    """Everything, with the depth alignment."""
    rsdf_region: Literal["ray", "wall"] = "ray"
    """Open. Depths compared along the whole ray (equation 15), or where f_v sees the outer face."""
    mlp_rate: Positive = 1e-4
    """Learning rate of the distance network; the paper's."""
    grid_rate: Positive = 2.5e-3
    """Open. Learning rate of the coarsest distance grid [m]; of finer ones in proportion. Where
    stage 1 has more than 3000 steps it is smaller in proportion, as all steps together would lead
    the surface farther."""
    other_rate: Positive = 1e-3
    """Learning rate of reflectivity, power and sharpness."""
    power_rate: Positive = 1e-2
    """Open. Learning rate of the logarithm of the power scalar."""
    final_rate: Share = 0.05
    """Share of each rate that the cosine ends at."""
    weight_decay: NotNegative = 0.01
    """Of AdamW, on networks; a distance grid must not shrink towards zero."""
    max_gradient_norm: Positive = 1.0
    """Open. Gradients of all networks together are cut off at this norm; grids are left alone."""
    crop_m: MarginM = 0.012
    """The box is cropped: the mesh keeps nothing nearer to the prior's surface than this [m]."""
    mesh_n: Annotated[int, Interval(ge=4, le=2048)] = 97
    """Voxels along a side of the grid that the mesh is taken from."""
    wall_delay: bool = False
    """Whether rendered echoes come as late as the known walls make them at right angles; the
    paper's do not."""
    glint_level: bool = False
    """Open. Whether the zero level is moved, once trained, by the one number that brings rendered
    glints to the depth of the measured ones."""
    device: Device = "auto"
    """Where fields, opacity, signals and losses are computed; "auto": on a GPU if torch has one.
    Rays are drawn and cut on the CPU."""
    checkpoint_every: Count = 500
    """Steps between checkpoints, where they take less than five minutes; else five minutes."""
    slice_every: CountOrZero = 0
    """Steps between pictures of a slice of the distance in `live/`; 0 for none."""
    tensorboard: bool = False
    """Write scalars for TensorBoard; wants the extra `geraf2[tensorboard]`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if list(self.grid_n) != sorted(self.grid_n):
            msg = f"grid_n must be ascending numbers, got {self.grid_n}"
            raise ValueError(msg)
        if self.octaves_start > self.octaves_end:
            msg = (
                f"octaves_start must be at most octaves_end = {self.octaves_end}, "
                f"got {self.octaves_start}"
            )
            raise ValueError(msg)
        if self.region == "content" and (self.start, self.rsdf_region) != ("ball", "ray"):
            msg = (
                'region "content" holds no walls: start must be "ball" and rsdf_region "ray", got '
                f"{self.start} and {self.rsdf_region}"
            )
            raise ValueError(msg)
        if self.bank > self.n_antennas:
            msg = f"bank must be at most n_antennas = {self.n_antennas}, got {self.bank}"
            raise ValueError(msg)
        if self.bank > 1 and self.window_m > 0.0:
            msg = f"bank must be 1 where window_m is not 0, got {self.bank} and {self.window_m}"
            raise ValueError(msg)


@dataclass(frozen=True, kw_only=True)
class CorrectedPaperConfig(PaperConfig):
    """Constants of `--preset paper-corrected`: the biases of level taken out.

    Weight, spreading, lobe, targets, delay of walls, sharpness, depth alignment; and longer, at a
    lower rate. Every other constant is that of `paper`. Derived in docs/math.md#lensless-level,
    measured in docs/paper-results.md.
    """

    two_way: TwoWayForm = "unbiased"
    """"squared": T^2 alpha, equation 4, 5 / (6 s) in front of the surface in power. "unbiased":
    T alpha with T that of both ways, at the surface."""
    spreading: Spreading = "two-way"
    """"none": equation 4. "two-way": 1 / u^2 of equation 2, relative to the scene's middle."""
    lobe_power: LobePower = 8.0
    """Exponent of w_o . w_r; the echo of a ball of radius r lies r / (8 lobe_power) too deep."""
    bright_targets: Share = 0.0
    """Share of targets drawn where the plane's measured map is bright, which is behind a smooth
    surface: a whole plane focuses its echo there."""
    region: Region = "content"
    """"content": rays, targets and voxels lie in the crop alone, a fifth closer together than in
    all of the scene."""
    n_cells: Annotated[int, Interval(ge=2, le=4096)] = 28
    """Cells along the side of the content's disc: as dense as 32 of the scene's."""
    octaves_end: Octaves = 6.0
    """Octaves of a network's encoding that are open from the end of stage 1 on: the waves of the
    others are shorter than samples are apart, and learn noise."""
    n_clusters: CountOrZero = 1
    """Groups of antennas that share a transmittance: those of a window see a sample alike."""
    inv_s_start: Positive = 120.0
    """Sharpness s at the start [1/m]; the echo of a soft ball of radius r lies 2.6 / (s^2 r) in
    front of it, and what training has carved away hardly comes back."""
    grid_rate: Positive = 1e-3
    """Learning rate of the coarsest distance grid [m]; of finer ones in proportion, and smaller in
    proportion where stage 1 has more than 3000 steps."""
    stage1: StageConfig = dataclasses.field(default_factory=lambda: StageConfig(n_steps=3000))
    """Shape, with reflectivity frozen at 1."""
    stage2: StageConfig = dataclasses.field(
        default_factory=lambda: StageConfig(
            n_steps=300, rsdf_weight=0.1, train_reflectivity=True, shape_rate=0.25
        )
    )
    """Everything, with a tenth of the depth alignment and a quarter of the distance's rate: all of
    the alignment pulls the surface in, and the noise of longer steps carves it."""
    wall_delay: bool = True
    """Whether rendered echoes come as late as the known walls make them at right angles."""
    glint_level: bool = True
    """Whether the zero level is moved, once trained, by the one number that brings rendered glints
    to the depth of the measured ones: L_MF knows that depth less well than the width of a glint."""
