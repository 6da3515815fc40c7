"""`geraf2 reconstruct --preset geraf1`: the learned route before the walls were modelled.

After what the paper says of its predecessor: the box is cropped out of the radar image, the field
is the distance of one region, nothing outside corrects its transmittance, and the level is chosen
after the training. In the publication that is done by hand.
"""

from dataclasses import replace

from geraf2.baselines.heat import counted_voxels
from geraf2.baselines.level import LevelConfig, best_level
from geraf2.fields import SdfGrid
from geraf2.paper.config import PaperConfig
from geraf2.scene import Capture, LosPrior


def geraf1_config(config: PaperConfig) -> PaperConfig:
    """One stage with reflectivity, from a ball, without a vision field."""
    return replace(
        config,
        start="ball",
        ulos=False,
        stage1=replace(config.stage1, train_reflectivity=True, rsdf_weight=0.0),
        stage2=replace(config.stage2, n_steps=0),
    )


def cropped_prior(prior: LosPrior, crop_m: float) -> LosPrior:
    """Bounding box of the innermost known box, smaller by the crop [m] on every side; no walls."""
    size, center = prior.size_m, prior.center_m
    if len(prior.walls) > 1:
        size, center = prior.walls[-1].size_m, prior.walls[-1].center_m
    x, y, z = (side - 2.0 * crop_m for side in size)
    return LosPrior.from_box((x, y, z), center)


def at_best_level(
    sdf: SdfGrid,
    capture: Capture,
    prior: LosPrior,
    crop_m: float,
    config: LevelConfig,
    num_threads: int | None,
) -> SdfGrid:
    """Field moved so that its zero level is the one that explains the signals best."""
    counted = counted_voxels(prior, sdf.grid, crop_m, num_threads=num_threads)
    level = best_level(sdf, counted, capture, 0.0, config, num_threads=num_threads)
    return SdfGrid(grid=sdf.grid, values=(sdf.values - level).astype(sdf.values.dtype))
