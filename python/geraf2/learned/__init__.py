"""The paper's learned method: fields, lensless rendering, training, novel views.

`config` alone does not load torch.
"""

from geraf2.learned.config import PaperConfig, StageConfig

__all__ = ["PaperConfig", "StageConfig"]
