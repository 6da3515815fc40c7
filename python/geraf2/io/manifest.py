"""What a person may read and write of a scene: scene.toml and radar.toml, validated."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from geraf2.errors import UserError

SCENE_FORMAT: Literal["geraf2-scene"] = "geraf2-scene"
SCENE_VERSION: Literal[1] = 1

# Broad physical limits: they catch a value in GHz, us or mm, not a poor choice.
_FrequencyHz = Annotated[float, Field(ge=1e8, le=1e13)]
_SlopeHzPerS = Annotated[float, Field(ge=1e9, le=1e18)]
_RateHz = Annotated[float, Field(ge=1e2, le=1e12)]
_BiasM = Annotated[float, Field(ge=-100.0, le=100.0)]
_Metres = Annotated[float, Field(ge=-1e6, le=1e6)]
_SideM = Annotated[float, Field(gt=0.0, le=1e3)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class WaveformManifest(_Strict):
    """The chirp, see geraf2.scene.Waveform."""

    start_frequency_hz: _FrequencyHz
    chirp_slope_hz_per_s: _SlopeHzPerS
    sample_rate_hz: _RateHz
    n_samples: Annotated[int, Field(ge=1, le=1 << 20)]
    path_bias_m: _BiasM = 0.0


class WallManifest(_Strict):
    """One closed dielectric shell, see geraf2.scene.Wall."""

    size_m: Annotated[list[_SideM], Field(min_length=3, max_length=3)]
    thickness_m: _SideM
    permittivity: Annotated[float, Field(ge=1.0, le=1e3)]
    center_m: Annotated[list[_Metres], Field(min_length=3, max_length=3)] = [0.0, 0.0, 0.0]


class SceneManifest(_Strict):
    """Contents of scene.toml."""

    format: Literal["geraf2-scene"] = SCENE_FORMAT
    version: Literal[1] = SCENE_VERSION
    frame: Annotated[str, StringConstraints(min_length=1)] = "capture"
    unit: Literal["m"] = "m"
    waveform: WaveformManifest
    walls: list[WallManifest] = []
    provenance: dict[str, str] = {}


class RadarManifest(_Strict):
    """Contents of radar.toml: what an importer cannot read from the capture itself."""

    start_frequency_hz: _FrequencyHz | None = None
    chirp_slope_hz_per_s: _SlopeHzPerS | None = None
    sample_rate_hz: _RateHz | None = None
    n_samples: Annotated[int, Field(ge=1, le=1 << 20)] | None = None
    path_bias_m: _BiasM | None = None
    walls: list[WallManifest] | None = None


_Manifest = TypeVar("_Manifest", bound=BaseModel)


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file; a UserError names the line that cannot be read."""
    try:
        text = path.read_bytes().decode("utf-8")
    except FileNotFoundError:
        raise UserError(what="no such file", where=path) from None
    except IsADirectoryError:
        raise UserError(what="is a folder", where=path, expected="a TOML file") from None
    except UnicodeDecodeError as error:
        raise UserError(
            what=f"is not text in UTF-8 (byte {error.start})", where=path, expected="a TOML file"
        ) from None
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise UserError(what=f"is not valid TOML: {error}", where=path) from None


def validate(model: type[_Manifest], values: Mapping[str, Any], where: object) -> _Manifest:
    """Check `values` against `model`; every complaint on one line, naming its key."""
    try:
        return model.model_validate(dict(values))
    except ValidationError as error:
        raise UserError(_describe(error), where=where) from None


def read_manifest(model: type[_Manifest], path: Path) -> _Manifest:
    """Read and check one TOML file."""
    return validate(model, read_toml(path), path)


def _describe(error: ValidationError) -> str:
    complaints = []
    for item in error.errors(include_url=False):
        key = _dotted(item["loc"])
        if item["type"] == "extra_forbidden":
            complaints.append(f"unknown key {key!r}")
        elif item["type"] == "missing":
            complaints.append(f"key {key!r} is missing")
        else:
            reason = item["msg"][:1].lower() + item["msg"][1:]
            complaints.append(f"key {key!r}: {reason}, got {_short(item['input'])}")
    shown, rest = complaints[:4], len(complaints) - 4
    return "; ".join(shown) + (f"; and {rest} more" if rest > 0 else "")


def _dotted(location: tuple[int | str, ...]) -> str:
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
