"""Trainings by name; torch (2 s) is loaded when one is looked up."""

from typing import TYPE_CHECKING

from geraf2.pipeline.los_options import PhotoPreset

if TYPE_CHECKING:
    from geraf2.apps.photos.config import PhotoConfig


def photo_config(preset: PhotoPreset, seed: int = 0) -> "PhotoConfig":
    """Look the settings of a training up: a coarse grid, a fine one, or the paper's networks."""
    from geraf2.apps.photos import config  # noqa: PLC0415 - torch takes 2 s

    if preset == "paper":
        return config.MlpPhotoConfig(seed=seed)
    if preset == "default":
        return config.GridPhotoConfig(seed=seed)
    stages = tuple(config.GridStage(n_longest=n, n_steps=k) for n, k in ((48, 200), (80, 300)))
    return config.GridPhotoConfig(stages=stages, seed=seed)
