"""Settings of the paper's presets. "Open" marks those that the paper's text does not give."""

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Interval, MinLen

from geraf2._bounds import Bounded, Count, CountOrZero, Few, MarginM, NotNegative, Positive, Share

TRAINING_VERSION = 7
"""Raised when the trained field changes for the same capture and settings."""

FULL_RATE_STEPS = 3000
"""Steps of stage 1 up to which distance grids use the full rate."""

TwoWayForm = Literal["squared", "unbiased"]
Spreading = Literal["none", "two-way"]
LobePower = Annotated[float, Interval(gt=0.0, le=100.0)]
Octaves = Annotated[float, Interval(ge=0, le=10)]
FieldKind = Literal["grid", "mlp"]
Start = Literal["vision", "nested", "ball"]
Region = Literal["scene", "content"]
SharpnessRule = Literal["scheduled", "learned"]
Device = Literal["auto", "cpu", "cuda"]


@dataclass(frozen=True, kw_only=True)
class RenderConfig(Bounded):
    """Settings of the amplitude of equation 4 of the paper."""

    two_way: TwoWayForm = "squared"
    """"squared": T^2 alpha, equation 4, largest at f = ln 2 / s, in front of the surface.
    "unbiased": T alpha with the two-way T, largest at f = 0; not the paper's."""
    ulos: bool = True
    """Correct transmittance at the scene's boundary by the frozen vision field (ULoS rendering);
    when off, by the field under training, without a gradient."""
    n_clusters: CountOrZero = 4
    """Groups of antennas that share a transmittance; 0: each has its own, as in the paper."""
    lobe_power: LobePower = 4.0
    """Open. Exponent of w_o . w_r: equation 4 has 1, the appendix mentions a small spread."""
    spreading: Spreading = "none"
    """"none": equation 4. "two-way": 1 / u^2 of equation 2, relative to the scene's middle."""
    normal_gradient: bool = True
    """Open. Whether the lobe has a gradient to the field's normals."""
    n_looks: Few = 8
    """Open. Independent signals that share the samples; the powers of their heat maps are added.
    With 1 the heat map has speckle, as the sample spacing is several wavelengths."""


@dataclass(frozen=True, kw_only=True)
class StageConfig(Bounded):
    """Settings of one of the two stages."""

    n_steps: CountOrZero = 2000
    """Steps; the paper's 100,000 need a GPU."""
    rsdf_weight: NotNegative = 0.0
    """lambda_RSDF, weight of the depth alignment; 0 in stage 1."""
    train_reflectivity: bool = False
    """Whether reflectivity is trained; else it is 1."""
    shape_rate: Share = 1.0
    """Factor of the distance's learning rate: below 1 where a stage only refines."""


@dataclass(frozen=True, kw_only=True)
class PaperConfig(RenderConfig):
    """Settings of `--preset paper`."""

    field: FieldKind = "grid"
    """"mlp": the paper's networks, 8 x 256, 10 octaves; "grid": the same distance on a finer and
    finer grid."""
    start: Start = "ball"
    """Open. "vision": f_v, negative in the whole box. "nested": section 4.1 with a ball. "ball"
    alone."""
    start_radius: Positive = 0.5
    """Open. Radius of that ball over the prior's smallest half side; it rarely grows."""
    region: Region = "scene"
    """Open. Region of rays, targets and distance: "scene", the box and its walls; "content", its
    inside, where the mesh may be (crop_m)."""
    mlp_fit_steps: CountOrZero = 400
    """Open. Steps in which the network is fitted to its start before the training."""
    octaves_start: Octaves = 3.0
    """Open. Active octaves of the distance network's encoding at the start; the others follow
    evenly over stage 1."""
    octaves_end: Octaves = 10.0
    """Active octaves from the end of stage 1 on; the paper's 10."""
    grid_n: Annotated[tuple[Annotated[int, Interval(ge=3, le=2048)], ...], MinLen(1)] = (13, 25)
    """Open. Voxels along a side of the distance grid, one entry a level; levels share stage 1."""
    reflectivity_n: Annotated[int, Interval(ge=2, le=2048)] = 33
    """Open. Voxels along a side of the reflectivity grid."""
    sharpness: SharpnessRule = "scheduled"
    """Open. "scheduled": s grows geometrically over stage 1, then stays. "learned": as in NeuS."""
    inv_s_start: Positive = 60.0
    """Open. Sharpness s at the start [1/m]."""
    inv_s_end: Positive = 200.0
    """Open. Sharpness s from the end of stage 1 on [1/m], where scheduled."""
    n_cells: Annotated[int, Interval(ge=2, le=4096)] = 32
    """Cells along the side of the scene's disc: 804 rays."""
    n_samples: Annotated[int, Interval(ge=2, le=4096)] = 32
    """Samples of a ray."""
    n_antennas: Count = 256
    """Open. Largest number of antennas of a plane in a step; few of them raise the side lobes."""
    window_m: MarginM = 0.05
    """Open. Side of the square from which antennas are drawn [m]; 0: the whole plane."""
    n_planes: Count = 4
    """Open. Planes over whose gradients a step averages, evenly spaced among all."""
    n_targets: Count = 512
    """Open. Points at which rendered and measured heat map are compared in a step."""
    bright_targets: Share = 0.25
    """Open. Share of targets drawn where the plane's measured map is bright; the rest uniformly."""
    dark_plane: Share = 0.04
    """Open. A ray is dark where the plane's map stays below this share of its peak ..."""
    dark_scene: Share = 0.15
    """... and the map of all planes exceeds this share; dark rays are skipped, with 0 none."""
    eikonal_weight: NotNegative = 0.1
    """lambda_GRAD."""
    charbonnier: Positive = 1e-3
    """Open. Width of the Charbonnier loss, in units of the planes' mean peak."""
    stage1: StageConfig = dataclasses.field(default_factory=StageConfig)
    """Shape, with reflectivity frozen at 1."""
    stage2: StageConfig = dataclasses.field(
        default_factory=lambda: StageConfig(n_steps=1000, rsdf_weight=1.0, train_reflectivity=True)
    )
    """All fields, with the depth alignment."""
    mlp_rate: Positive = 1e-4
    """Learning rate of the distance network; the paper's."""
    grid_rate: Positive = 2.5e-3
    """Open. Learning rate of the coarsest distance grid [m]; proportional for finer ones. It is
    reduced in proportion where stage 1 has more than 3000 steps."""
    other_rate: Positive = 1e-3
    """Learning rate of reflectivity, power and sharpness."""
    power_rate: Positive = 1e-2
    """Open. Learning rate of the logarithm of the power scalar."""
    final_rate: Share = 0.05
    """Final over initial rates; they fall as a cosine."""
    weight_decay: NotNegative = 0.01
    """Weight decay of AdamW, on networks only."""
    max_gradient_norm: Positive = 1.0
    """Open. Largest norm of the gradients of all networks together; grids are not clipped."""
    crop_m: MarginM = 0.012
    """Crop of the box: the mesh keeps no part nearer to the prior's surface than this [m]."""
    mesh_n: Annotated[int, Interval(ge=4, le=2048)] = 97
    """Voxels along a side of the grid of the mesh."""
    wall_delay: bool = False
    """Whether rendered echoes have the delay of the known walls at normal incidence; the paper's do
    not."""
    glint_level: bool = False
    """Open. Whether the zero level is moved after the training so that rendered glints have the
    depth of the measured ones."""
    device: Device = "auto"
    """Device of fields, opacity, signals and losses; "auto": a GPU for networks, where
    torch has one. Rays are drawn and clipped on the CPU."""
    checkpoint_every: Count = 500
    """Steps between checkpoints, which are also written every five minutes."""

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
        if self.region == "content" and self.start != "ball":
            msg = f'region "content" holds no walls: start must be "ball", got {self.start}'
            raise ValueError(msg)


@dataclass(frozen=True, kw_only=True)
class CorrectedPaperConfig(PaperConfig):
    """Settings of `--preset paper-corrected`, without the biases of the surface's level.

    It changes weight, spreading, lobe, targets, wall delay, sharpness and depth alignment, and
    trains longer at a lower rate. Derived in docs/math/ray-march-and-lensless.md#lensless-level,
    measured in docs/paper-results.md.
    """

    two_way: TwoWayForm = "unbiased"
    """"squared": T^2 alpha, equation 4, 5 / (6 s) in front of the surface in power. "unbiased":
    T alpha with the two-way T, at the surface."""
    spreading: Spreading = "two-way"
    """"none": equation 4. "two-way": 1 / u^2 of equation 2, relative to the scene's middle."""
    lobe_power: LobePower = 8.0
    """Exponent of w_o . w_r; the echo of a ball of radius r lies r / (8 lobe_power) too deep."""
    bright_targets: Share = 0.0
    """Share of targets drawn where the plane's measured map is bright: a full aperture focuses the
    echo of a smooth surface behind it."""
    region: Region = "content"
    """"content": rays, targets and voxels lie in the crop alone, a fifth closer together than in
    all of the scene."""
    n_cells: Annotated[int, Interval(ge=2, le=4096)] = 28
    """Cells along the side of the content's disc, as dense as 32 of the scene's."""
    octaves_end: Octaves = 6.0
    """Active octaves of a network's encoding from the end of stage 1 on: waves of the others are
    shorter than the sample spacing, and would learn noise."""
    n_clusters: CountOrZero = 1
    """Groups of antennas that share a transmittance, which is nearly equal within a window."""
    inv_s_start: Positive = 120.0
    """Sharpness s at the start [1/m]; the echo of a soft ball of radius r lies 2.6 / (s^2 r) in
    front of it, and the training rarely restores a part that it has removed."""
    grid_rate: Positive = 1e-3
    """Learning rate of the coarsest distance grid [m]; scaled as in `paper`."""
    stage1: StageConfig = dataclasses.field(default_factory=lambda: StageConfig(n_steps=3000))
    """Shape, with reflectivity frozen at 1."""
    stage2: StageConfig = dataclasses.field(
        default_factory=lambda: StageConfig(
            n_steps=300, rsdf_weight=0.1, train_reflectivity=True, shape_rate=0.25
        )
    )
    """All fields, with a tenth of the depth alignment and a quarter of the distance's rate: the
    full alignment pulls the surface inward, and longer steps erode it by noise."""
    wall_delay: bool = True
    """Whether rendered echoes have the delay of the known walls at normal incidence."""
    glint_level: bool = True
    """Whether the zero level is moved after the training so that rendered glints have the depth of
    the measured ones; L_MF is less sensitive to that depth than to the width of a glint."""
