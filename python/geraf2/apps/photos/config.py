"""Settings of the training of a surface from photos."""

from dataclasses import dataclass, field

from geraf2._validation import require_each, require_least, require_positive
from geraf2.apps.photos.neus.coloured_grid import ColouredGridConfig
from geraf2.apps.photos.neus.rendering import PhotoSamplingConfig


@dataclass(frozen=True, kw_only=True)
class GridStage:
    """Steps on one grid."""

    n_longest: int
    """Voxels along the longest side of the region."""
    n_steps: int
    """Steps of the optimiser."""

    def __post_init__(self) -> None:
        require_least(self, n_longest=4, n_steps=1)


@dataclass(frozen=True, kw_only=True)
class PhotoConfig:
    """Settings of a training on grids from coarse to fine."""

    stages: tuple[GridStage, ...] = (
        GridStage(n_longest=64, n_steps=400),
        GridStage(n_longest=112, n_steps=500),
        GridStage(n_longest=176, n_steps=400),
    )
    """Grids one after the other."""
    rays_per_step: int = 2048
    """Rays drawn for a step."""
    model: ColouredGridConfig = field(default_factory=ColouredGridConfig)
    """Size of the colour's part."""
    sampling: PhotoSamplingConfig = field(default_factory=PhotoSamplingConfig)
    """Samples of a ray: only those near the surface are rendered."""
    first_sharpness: float = 1.0
    """Sharpness at the start, over the voxel; later stages continue from the last."""
    last_sharpness: float = 1.5
    """Sharpness at the end of a stage, over its voxel: as sharp as the grid can hold."""
    final_sharpness: float = 3.0
    """Sharpness at the end of the last stage, over its voxel."""
    colour_first: float = 0.5
    """Share of the first grid's steps with a fixed distance, in which the colour is learned."""
    distance_rate: float = 0.03
    """Learning rate of the signed distance, over the voxel."""
    feature_rate: float = 0.02
    """Learning rate of the features."""
    network_rate: float = 2e-3
    """Learning rate of the networks."""
    final_rate: float = 0.1
    """Final over initial rates, at the end of the last stage."""
    eikonal_weight: float = 0.03
    """Weight of mean (|gradient| - 1)^2."""
    mask_weight: float = 0.3
    """Weight of the cross entropy of opacity and silhouette."""
    bending: float = 0.006
    """Strength of the pull of the values to the mean of their neighbours, see PhotoTrainer."""
    blur_passes: int = 2
    """Passes of the binomial filter over the gradient to the values."""
    seed: int = 0
    """Of rays, samples and networks."""

    def __post_init__(self) -> None:
        if not self.stages:
            msg = "stages must name at least one grid"
            raise ValueError(msg)
        sharpness = ("first_sharpness", "last_sharpness", "final_sharpness")
        rates = ("distance_rate", "feature_rate", "network_rate", "final_rate")
        require_each(require_positive, self, "rays_per_step", *sharpness, *rates)
