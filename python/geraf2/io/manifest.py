"""Records of scene.toml and radar.toml, validated."""

from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints

from geraf2.records import (
    BiasM,
    FrequencyHz,
    Metres,
    RateHz,
    SampleCount,
    SlopeHzPerS,
    Wall,
    Waveform,
    require_outermost_first,
)

SCENE_FORMAT: Literal["geraf2-scene"] = "geraf2-scene"
SCENE_VERSION: Literal[1] = 1

# Under this name the provenance states whether the instrument delay is known.
DELAY_KEY = "path_bias"
DELAY_GIVEN, DELAY_NOT_KNOWN = "given", "not known, taken as 0 m"
DELAY_WITHOUT_EFFECT = "without effect on one frequency"


def _nested(walls: tuple[Wall, ...]) -> tuple[Wall, ...]:
    require_outermost_first(walls)
    return walls


Walls = Annotated[tuple[Wall, ...], AfterValidator(_nested)]
"""Outermost first."""
_Vector = Annotated[list[Metres], Field(min_length=3, max_length=3)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class CalibrationManifest(_Strict):
    """What `geraf2 calibrate` found and applied; samples and positions of the scene have it.

    Every uncertainty is one standard deviation. What was not searched is missing.
    """

    scene: str
    """Name of the scene that was calibrated."""
    prior: str
    """Prior: the outside of the box."""
    software: str
    delay_from: Literal["walls", "kept"]
    leakage: str | None = None
    """Level, delays and method of the leakage that was subtracted."""
    path_bias_before_m: BiasM
    path_bias_m: BiasM
    path_bias_sigma_m: float | None = None
    n_wall_echoes: int | None = None
    wall_rms_before_m: float | None = None
    """Of wall echoes about the prior's walls, the delay subtracted."""
    wall_rms_m: float | None = None
    prior_to_capture: list[list[float]] | None = None
    """Rigid transform by which los.ply was moved, 4 x 4, columns times (x, y, z, 1)."""
    prior_rotation_sigma_rad: list[float] | None = None
    prior_translation_sigma_m: list[float] | None = None
    """Close to the assumed value where the scan does not determine it."""
    channels: str | None = None
    """How antennas are divided into channels."""
    channel_phases_rad: list[float] | None = None
    """Subtracted from the samples of each channel."""
    channel_phase_sigmas_rad: list[float] | None = None
    position_coefficients_m: list[list[float]] | None = None
    """Cubic splines over the antennas of each pose, along its looking direction."""
    position_sigma_m: float | None = None
    coherence_before: float | None = None
    """Of the strong echoes: |sum| / sum of magnitudes of what their antennas add."""
    coherence: float | None = None


class SceneManifest(_Strict):
    """Contents of scene.toml."""

    format: Literal["geraf2-scene"] = SCENE_FORMAT
    version: Literal[1] = SCENE_VERSION
    frame: Annotated[str, StringConstraints(min_length=1)] = "capture"
    unit: Literal["m"] = "m"
    waveform: Waveform
    walls: Walls = ()
    calibration: tuple[CalibrationManifest, ...] = ()
    provenance: dict[str, str] = {}


ComplexLayout = Literal["4-lane", "2-lane-pairs", "2-lane-sequential", "iq", "iq-sequential"]
RealLayout = Literal["real-sequential", "real-alternating"]
"""Orders of the 16-bit words of complex and of real samples."""


class RawManifest(_Strict):
    """How a raw capture of a TI board is stored; what is missing is determined."""

    layout: ComplexLayout | RealLayout | None = None
    """Order of the 16-bit words, see docs/bring-your-own-scan.md."""
    offset_binary: bool | None = None
    n_rx: Annotated[int, Field(ge=1, le=64)] | None = None
    n_tx: Annotated[int, Field(ge=1, le=64)] | None = None
    """Transmitters that take turns, chirp by chirp."""
    n_chirps_per_frame: Annotated[int, Field(ge=1, le=1 << 20)] | None = None
    """Chirps of all transmitters and loops; a frame is taken as one place."""
    frame_period_s: Annotated[float, Field(gt=0.0, le=1e6)] | None = None
    start_time_s: float | None = None
    """Time of the first frame on the clock of the positions."""
    chirp_s: Annotated[float, Field(gt=0.0, le=1e3)] | None = None
    """From one chirp to the next; with it, transmitters that take turns while the radar moves
    along a log with time stamps have positions of their own."""


def _are_orthonormal(rows: list[list[float]]) -> list[list[float]]:
    axes = np.asarray(rows)
    if float(np.abs(axes @ axes.T - np.eye(3)).max()) > 1e-3:
        msg = f"must be orthonormal rows, got {rows}"
        raise ValueError(msg)
    return rows


_Axes = Annotated[
    list[_Vector], Field(min_length=3, max_length=3), AfterValidator(_are_orthonormal)
]


class AntennaManifest(_Strict):
    """The board on the end effector; all in the frame of the end effector."""

    tx_offsets_m: Annotated[list[_Vector], Field(min_length=1)] | None = None
    rx_offsets_m: Annotated[list[_Vector], Field(min_length=1)] | None = None
    axes: _Axes | None = None
    """Looking direction, horizontal, vertical; by default x, y, z."""


def _is_step(value: float) -> float:
    if abs(value) < 1e-6:
        msg = f"must be a distance between positions, got {value:g} m"
        raise ValueError(msg)
    return value


_StepM = Annotated[Metres, AfterValidator(_is_step)]


class RasterManifest(_Strict):
    """Raster of the radar's positions, one row after the other."""

    n_rows: Annotated[int, Field(ge=1, le=1 << 20)]
    n_columns: Annotated[int, Field(ge=1, le=1 << 20)]
    row_step_m: _StepM
    column_step_m: _StepM
    serpentine: bool = False
    """Whether every other row was scanned backwards."""
    center_m: _Vector = [0.0, 0.0, 0.0]


class RadarManifest(_Strict):
    """Contents of radar.toml: what an importer cannot read from the capture itself."""

    start_frequency_hz: FrequencyHz | None = None
    chirp_slope_hz_per_s: SlopeHzPerS | None = None
    sample_rate_hz: RateHz | None = None
    n_samples: SampleCount | None = None
    path_bias_m: BiasM | None = None
    adc_start_s: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    """Start of the ramp to the first sample; start_frequency_hz is then that of the ramp."""
    walls: Walls | None = None
    raw: RawManifest = RawManifest()
    antennas: AntennaManifest = AntennaManifest()
    raster: RasterManifest | None = None
    arrays: dict[str, str] = {}
    """Our name of an array to its name in a MATLAB file."""

    def first_sample_hz(self) -> float | None:
        """Frequency of the first sample, start + slope x ADC start; None while unknown."""
        if self.start_frequency_hz is None or not self.adc_start_s:
            return self.start_frequency_hz
        if self.chirp_slope_hz_per_s is None:
            return None
        return self.start_frequency_hz + self.chirp_slope_hz_per_s * self.adc_start_s
