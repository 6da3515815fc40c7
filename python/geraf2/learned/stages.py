"""Position of a training in its two stages, and the schedules that depend on it."""

import math

from geraf2.errors import UserError
from geraf2.learned.config import PaperConfig, StageConfig
from geraf2.learned.fields import SdfField, SdfMlp


class TrainingStages:
    """Stage and step of a training, with the schedules of resolution, octaves and sharpness."""

    def __init__(self, config: PaperConfig) -> None:
        self._config = config
        self.stage = 1
        """Stage of the next step: 1 or 2."""
        self.step = 0
        """Number of the next step in its stage."""

    @property
    def current(self) -> StageConfig:
        """Settings of the current stage."""
        return self._config.stage1 if self.stage == 1 else self._config.stage2

    @property
    def total_steps(self) -> int:
        """Number of steps of both stages."""
        return self._config.stage1.n_steps + self._config.stage2.n_steps

    @property
    def steps_done(self) -> int:
        """Number of steps done in both stages."""
        return self.step + (0 if self.stage == 1 else self._config.stage1.n_steps)

    @property
    def is_done(self) -> bool:
        """Whether both stages are complete."""
        return self.steps_done >= self.total_steps

    @property
    def progress(self) -> float:
        """Share of the current stage that is done."""
        return self.step / max(self.current.n_steps, 1)

    @property
    def _stage_1_progress(self) -> float:
        return 1.0 if self.stage == 2 else self.progress

    @property
    def grid_n(self) -> int:
        """Voxels along a side of the distance grid in stage 1, which the levels share evenly."""
        levels, n_steps = self._config.grid_n, max(self._config.stage1.n_steps, 1)
        return levels[min(len(levels) * self.step // n_steps, len(levels) - 1)]

    @property
    def inv_s(self) -> float:
        """Scheduled sharpness [1/m]: grows geometrically over stage 1."""
        low, high = math.log(self._config.inv_s_start), math.log(self._config.inv_s_end)
        return math.exp(low + self._stage_1_progress * (high - low))

    def open_octaves(self, sdf: SdfField) -> None:
        """Open as many octaves of a network's encoding as are due; grids have none."""
        first, last = self._config.octaves_start, self._config.octaves_end
        if isinstance(sdf, SdfMlp):
            sdf.open_octaves(first + self._stage_1_progress * (last - first))

    def require_finite(self, name: str, value: float) -> None:
        """Raise UserError with stage and step where a value is not finite."""
        if not math.isfinite(value):
            raise UserError(
                what=f"{name} is not finite in stage {self.stage}, step {self.step}",
                expected="a finite number",
                hint="the last checkpoint is kept; lower the learning rates and use --resume",
            )
