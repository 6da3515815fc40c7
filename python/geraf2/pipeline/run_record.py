"""What was asked of a run: config.toml of its folder, from which it can be repeated."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from geraf2.errors import UserError
from geraf2.io.toml import from_table, read_table, to_table, write_toml
from geraf2.pipeline.los_options import LosOptions
from geraf2.pipeline.presets import PRESETS, GlintPreset, PresetConfig
from geraf2.pipeline.prior import PriorSource


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """What the result of a run depends on besides capture, prior and the preset's constants.

    UserError for a negative seed.

    >>> geraf2.RunOptions(hold_out=(60.0, 180.0)).hold_out
    (60.0, 180.0)
    """

    hold_out: tuple[float, ...] = ()
    """Turntable angles of planes that are left out, for `geraf2 render` [degrees]."""
    trust_los: bool = False
    """Go on even if most of the echoes come from outside the box."""
    calibrate: Literal["auto", "no"] = "auto"
    """Whether what the capture does not know of itself is found and taken off first."""
    seed: int = 0
    """Of the samples that `evaluate` draws, of training and of the fit to heat maps."""
    photos: LosOptions = field(default_factory=LosOptions)
    """How photos are meant, where the prior is made of them."""

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise UserError(what="--seed must not be negative", got=self.seed)


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """Everything that a run was asked for."""

    scene: Path | None = None
    """Scene folder; None where the capture was given in memory."""
    prior: PriorSource = field(default_factory=PriorSource)
    """Where the outside of the box came from."""
    options: RunOptions = field(default_factory=RunOptions)
    config: PresetConfig = field(default_factory=GlintPreset)
    """Preset and its constants."""

    def write(self, path: Path) -> None:
        """Write config.toml; paths are absolute, so that it can be read from any folder."""
        scene = {} if self.scene is None else {"scene": str(self.scene.resolve())}
        parts = (to_table(part) for part in (self.prior.resolved(), self.options, self.config))
        write_toml(path, {**scene, **{k: v for part in parts for k, v in part.items()}})

    @classmethod
    def read(cls, path: Path) -> "RunRecord":
        """Read config.toml; a UserError names what is unknown or wrong in it."""
        table = read_table(path)
        scene = table.pop("scene", None)

        def own(kind: type[PriorSource] | type[RunOptions]) -> dict[str, Any]:
            return {e.name: table.pop(e.name) for e in fields(kind) if e.name in table}

        return cls(
            scene=None if scene is None else Path(str(scene)),
            prior=from_table(own(PriorSource), PriorSource, path),
            options=from_table(own(RunOptions), RunOptions, path),
            config=from_table(table, tuple(PRESETS.values()), path, told_by="preset"),
        )
