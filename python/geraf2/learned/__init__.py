"""The paper's learned route: losses, stages, checkpoints, novel views.

`config` alone does not load torch.
"""

from geraf2.learned.config import PaperConfig, StageConfig

__all__ = ["PaperConfig", "StageConfig"]
