"""Training of fields: the paper's method on captures, and surfaces from photos (`photos`).

`config` alone does not load torch.
"""

from geraf2.training.config import PaperConfig, StageConfig

__all__ = ["PaperConfig", "StageConfig"]
