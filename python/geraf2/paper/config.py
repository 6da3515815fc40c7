"""Every choice of the paper's preset; what its text leaves open says so."""

import dataclasses
from dataclasses import dataclass
from typing import Literal

from geraf2._validation import (
    require_each,
    require_fraction,
    require_least,
    require_not_negative,
    require_positive,
)
from geraf2.rendering.config import RenderConfig

TRAINING_VERSION = 1
"""Raised when the same capture and settings train another field."""

FieldKind = Literal["grid", "mlp"]
Start = Literal["vision", "nested", "ball"]
SharpnessRule = Literal["scheduled", "learned"]


@dataclass(frozen=True, kw_only=True)
class StageConfig:
    """One of the two stages."""

    n_steps: int = 2000
    """Steps; the paper's 100,000 want a GPU."""
    rsdf_weight: float = 0.0
    """lambda_RSDF, weight of the depth alignment; 0 in stage 1."""
    train_reflectivity: bool = False
    """Whether reflectivity learns; else it stays 1."""

    def __post_init__(self) -> None:
        require_each(require_not_negative, self, "n_steps", "rsdf_weight")


@dataclass(frozen=True, kw_only=True)
class PaperConfig(RenderConfig):
    """Constants of `--preset paper`."""

    field: FieldKind = "grid"
    """"mlp": the paper's, 8 x 256, 10 octaves; "grid": the same distance on a finer and finer
    grid."""
    start: Start = "ball"
    """Open. "vision": f_v, negative in the whole box. "nested": section 4.1 with a ball. "ball"
    alone."""
    start_radius: float = 0.5
    """Open. Radius of that ball over the prior's smallest half side; training hardly grows it."""
    mlp_fit_steps: int = 400
    """Open. Steps in which the network is fitted to its start before it sees an echo."""
    grid_n: tuple[int, ...] = (13, 25)
    """Open. Voxels along a side of the distance grid, one entry a level; levels share stage 1."""
    grid_smoothing: float = 0.0
    """Open. Standard deviation, in voxels, by which gradients to the grid are blurred; 0: none."""
    reflectivity_n: int = 33
    """Open. Voxels along a side of the reflectivity grid."""
    sharpness: SharpnessRule = "scheduled"
    """Open. "scheduled": s grows geometrically over stage 1 and stays. "learned": as in NeuS."""
    inv_s_start: float = 60.0
    """Open. Sharpness s at the start [1/m]."""
    inv_s_end: float = 200.0
    """Open. Sharpness s from the end of stage 1 on [1/m], where scheduled."""
    n_cells: int = 32
    """Cells along the side of the scene's disc: 804 rays."""
    n_samples: int = 32
    """Samples of a ray."""
    n_antennas: int = 256
    """Open. Most antennas of a plane in a step; few leave a pedestal of side lobes."""
    window_m: float = 0.05
    """Open. Side of the square that they are drawn from [m]; 0: the whole plane."""
    bank: int = 1
    """One part in `bank` of them is rendered, the rest remembered; 1 with a window."""
    n_targets: int = 512
    """Open. Places at which rendered and measured heat map are compared in a step."""
    bright_targets: float = 0.25
    """Open. Share of them drawn where the plane's measured map is bright; the rest uniformly."""
    dark_plane: float = 0.04
    """Open. A ray is dark where the plane's map stays below this share of its peak ..."""
    dark_scene: float = 0.15
    """... and the map of all planes exceeds this share: dark rays are left out; 0 keeps all."""
    eikonal_weight: float = 0.1
    """lambda_GRAD."""
    charbonnier: float = 1e-3
    """Open. Width of the Charbonnier loss, in units of the planes' mean peak."""
    stage1: StageConfig = dataclasses.field(default_factory=StageConfig)
    """Shape, with reflectivity frozen at 1."""
    stage2: StageConfig = dataclasses.field(
        default_factory=lambda: StageConfig(n_steps=1000, rsdf_weight=1.0, train_reflectivity=True)
    )
    """Everything, with the depth alignment."""
    rsdf_region: Literal["ray", "wall"] = "ray"
    """Open. Depths compared along the whole ray (equation 15), or where f_v sees the outer face."""
    mlp_rate: float = 1e-4
    """Learning rate of the distance network."""
    grid_rate: float = 2.5e-3
    """Open. Learning rate of the coarsest distance grid [m]; of finer ones in proportion."""
    other_rate: float = 1e-3
    """Learning rate of reflectivity, power and sharpness."""
    power_rate: float = 1e-2
    """Open. Learning rate of the logarithm of the power scalar."""
    final_rate: float = 0.05
    """Share of each rate that the cosine ends at."""
    weight_decay: float = 0.01
    """Of AdamW, on networks; a distance grid must not shrink towards zero."""
    max_gradient_norm: float = 1.0
    """Open. Gradients of all networks together are cut off at this norm; grids are left alone."""
    crop_m: float = 0.012
    """The box is cropped: the mesh keeps nothing nearer to the prior's surface than this [m]."""
    mesh_n: int = 97
    """Voxels along a side of the grid that the mesh is taken from."""
    checkpoint_every: int = 500
    """Steps between checkpoints."""
    slice_every: int = 0
    """Steps between pictures of a slice of the distance in `live/`; 0 for none."""
    tensorboard: bool = False
    """Write scalars for TensorBoard; wants the extra `geraf2[tensorboard]`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        rates = ("mlp_rate", "grid_rate", "other_rate", "power_rate", "max_gradient_norm")
        shape = ("start_radius", "inv_s_start", "inv_s_end", "charbonnier")
        require_each(require_positive, self, *shape, *rates)
        require_least(self, n_cells=2, n_samples=2, n_antennas=1, bank=1, n_targets=1)
        require_least(self, reflectivity_n=2, mesh_n=4, checkpoint_every=1)
        require_least(self, slice_every=0, mlp_fit_steps=0)
        if not self.grid_n or min(self.grid_n) < 3 or list(self.grid_n) != sorted(self.grid_n):
            msg = f"grid_n must be ascending numbers of at least 3, got {self.grid_n}"
            raise ValueError(msg)
        if self.bank > self.n_antennas:
            msg = f"bank must be at most n_antennas = {self.n_antennas}, got {self.bank}"
            raise ValueError(msg)
        require_each(require_not_negative, self, "grid_smoothing", "window_m")
        if self.bank > 1 and self.window_m > 0.0:
            msg = f"bank must be 1 where window_m is not 0, got {self.bank} and {self.window_m}"
            raise ValueError(msg)
        shares = ("bright_targets", "dark_plane", "dark_scene", "final_rate")
        require_each(require_fraction, self, *shares)
