"""Request of a run: config.toml of its folder, which can repeat it."""

import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from geraf2._bounds import Arg, Bounded, CountOrZero, Degrees, Seed
from geraf2.io.objects import absolute_path, is_remote
from geraf2.io.toml import from_table, read_table, to_table, write_toml
from geraf2.pipeline.los_options import LosOptions
from geraf2.pipeline.presets import BestPreset, PresetConfig, preset_of_table
from geraf2.pipeline.prior import PriorSource


@dataclass(frozen=True, kw_only=True)
class RunOptions(Bounded):
    """Options of a run besides capture, prior and the preset's constants.

    Raises
    ------
    UserError
        For a value out of bounds.

    Examples
    --------
    >>> geraf2.RunOptions(hold_out=(60.0, 180.0)).hold_out
    (60.0, 180.0)
    """

    hold_out: Annotated[tuple[Degrees, ...], Arg(metavar="DEG ...")] = ()
    """Turntable angles of planes that are left out, for `geraf2 render` [degrees]."""
    reverse_turn: bool = False
    """The turntable ran in the other sense than recorded: planes lie at the angles -a, not a."""
    trust_los: bool = False
    """Use the prior unchanged, even if echoes of walls or content contradict it."""
    calibrate: Literal["auto", "no"] = "auto"
    """auto: estimate errors of leakage, channels, delay, box, axis and positions, and correct those
    that held-out data confirm. no: use the scene unchanged."""
    seed: Seed = 0
    """Seed of the samples of `evaluate`, and of training."""
    samples: Annotated[CountOrZero, Arg(metavar="N")] = 0
    """Also write N samples of the surface to samples.npz."""
    photos: Annotated[LosOptions, Arg(see="geraf2 los")] = field(default_factory=LosOptions)
    """Options of the photos of --los."""


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """Complete request of a run."""

    scene: Path | None = None
    """Scene folder; None for a capture in memory."""
    prior: PriorSource = field(default_factory=PriorSource)
    """Source of the outside of the box."""
    options: RunOptions = field(default_factory=RunOptions)
    config: PresetConfig = field(default_factory=BestPreset)
    """Preset and its constants."""

    def write(self, path: Path, *, seen_from: Path | None = None) -> None:
        """Write config.toml, which can be read from any folder.

        Paths are absolute, and also relative to the file, so that a folder moved together with its
        inputs still finds them. A path that is not UTF-8 text is left out.

        seen_from: folder that the file is about to be in; that of `path` when None.
        """
        known = {
            n: absolute_path(p) for n, p in self._paths().items() if p is not None and _is_text(p)
        }
        here = (seen_from or path.parent).resolve()
        record = self._with_paths(known)
        scene = {} if record.scene is None else {"scene": str(record.scene)}
        parts = (to_table(part) for part in (record.prior, record.options, record.config))
        table: dict[str, Any] = {**scene, **{k: v for part in parts for k, v in part.items()}}
        if known:
            on_disk = {name: path for name, path in known.items() if not is_remote(path)}
            table["places"] = {name: os.path.relpath(path, here) for name, path in on_disk.items()}
        write_toml(path, table)

    @classmethod
    def read(cls, path: Path) -> "RunRecord":
        """Read config.toml; the UserError names its unknown or wrong entries."""
        table = read_table(path)
        scene, relative_paths = table.pop("scene", None), table.pop("places", {})

        def own(kind: type[PriorSource] | type[RunOptions]) -> dict[str, Any]:
            return {e.name: table.pop(e.name) for e in fields(kind) if e.name in table}

        record = cls(
            scene=None if scene is None else Path(str(scene)),
            prior=from_table(own(PriorSource), PriorSource, path),
            options=from_table(own(RunOptions), RunOptions, path),
            config=preset_of_table(table, path),
        )
        found = record._paths()
        for name, relative in relative_paths.items() if isinstance(relative_paths, dict) else ():
            moved = path.parent / str(relative)
            kept = found.get(name)
            # Remote stores are not contacted: the record may come from an untrusted source.
            missing = kept is not None and not is_remote(kept) and not kept.exists()
            if missing and moved.exists():
                found[name] = moved.resolve()
        return record._with_paths(found)

    def command(self, scene: str) -> str:
        """Command that repeats the run on a scene with this name; paths are reduced to names."""
        words = ["geraf2", "reconstruct", scene, "OUT"]
        if self.prior.los is not None:
            words += ["--los", self.prior.los.name]
        default = type(self.config)()
        words += _flags(replace(self.prior, los=None), PriorSource())
        words += ["--preset", self.config.preset, *_flags(self.options, RunOptions())]
        return shlex.join([*words, *_flags(self.config, default)])

    def _paths(self) -> dict[str, Path | None]:
        photos = self.options.photos
        return {
            "scene": self.scene,
            "los": self.prior.los,
            "to_radar": photos.to_radar,
            "masks": photos.masks,
        }

    def _with_paths(self, paths: Mapping[str, Path | None]) -> "RunRecord":
        photos = replace(
            self.options.photos, to_radar=paths.get("to_radar"), masks=paths.get("masks")
        )
        return replace(
            self,
            scene=paths.get("scene"),
            prior=replace(self.prior, los=paths.get("los")),
            options=replace(self.options, photos=photos),
        )


def _is_text(path: Path) -> bool:
    """Whether the absolute path can be encoded as text."""
    try:
        str(absolute_path(path)).encode()
    except UnicodeEncodeError:
        return False
    return True


def _flags(value: Any, default: Any, prefix: str = "--") -> list[str]:
    """Command line flags that turn the default record into this one."""
    words: list[str] = []
    for entry in fields(value):
        mine, usual = getattr(value, entry.name), getattr(default, entry.name)
        name = entry.name.replace("_", "-")
        if is_dataclass(mine):
            words += _flags(mine, usual, f"{prefix}{name}.")
        elif mine != usual and isinstance(mine, bool):
            words.append(f"{prefix}{name if mine else f'no-{name}'}")
        elif mine != usual:
            values = mine if isinstance(mine, tuple) else (mine,)
            words += [prefix + name, *(v.name if isinstance(v, Path) else str(v) for v in values)]
    return words
