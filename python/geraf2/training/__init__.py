"""Training of fields on captures: the paper's method. `config` alone does not load torch."""

from geraf2.training.config import PaperConfig, StageConfig

__all__ = ["PaperConfig", "StageConfig"]
