"""Errors of a real scan beyond the ideal one: every effect a switch, in two presets.

docs/world.md describes each effect, its size on real hardware and the source of that size.
"""

import math
from dataclasses import Field, dataclass, field, fields
from typing import Annotated, Any, Literal

from annotated_types import Interval

from geraf2._bounds import Bounded, LengthM, NotNegative, Share
from geraf2.io.toml import nearest_name

_Angle = Annotated[float, Interval(ge=0.0, le=3600.0)]
_TurnDeg = Annotated[float, Interval(ge=-10.0, le=10.0)]
_MarginDb = Annotated[float, Interval(ge=0.0, le=300.0)]
_OptionalDb = Annotated[float, Interval(le=300.0)]
ErrorM = Annotated[float, Interval(ge=0.0, le=0.05)]
"""Displacement of a surface or an antenna [m]; larger ones are no errors of a scan."""

# Marks a field that takes its value from the preset.
_OF_PRESET: Any = None
# Another object rather than an error of the scan: on only if named.
_NOT_BY_DEFAULT = ("dielectric",)


def _level(effect: str, off: object, plausible: object, hard: object) -> Any:
    """Field of an effect, with its values without and with the presets."""
    levels = {"none": off, "plausible": plausible, "hard": hard}
    return field(default=_OF_PRESET, metadata={"effect": effect, **levels})


@dataclass(frozen=True, kw_only=True)
class WorldSpec(Bounded):
    """Effects beyond an ideal scan: off, or from a preset, with single values replaced.

    A value that is not given is that of the preset where its effect is on, else off. ValueError
    for an unknown effect and for values out of range.

    >>> from geraf2.simulation import WorldSpec
    >>> world = WorldSpec(preset="plausible", effects=("leakage", "iq"))
    >>> world.leakage_db, world.iq_phase_error_deg, world.wall_bulge_m
    (10.0, 2.0, 0.0)
    """

    preset: Literal["none", "plausible", "hard"] = "none"
    """Source of the values that are not given."""
    effects: tuple[str, ...] = ()
    """Effects that the preset switches on, see docs/world.md; none named: all but dielectric."""

    wall_waves: bool = _level("waves", False, True, True)
    """waves: far walls as waves rather than with sharp shadows."""
    multipath: bool = _level("waves", False, True, True)
    """waves: multipath via the wall."""
    second_bounce: bool = _level("second_bounce", False, True, True)
    """second_bounce: paths that touch the object twice."""
    figure_permittivity: Annotated[float, Interval(ge=0.0, le=1e3)] = _level(
        "dielectric", 0.0, 2.7, 3.45
    )
    """dielectric: relative permittivity of the object, whose back face echoes too; 0: metal."""
    figure_loss_tangent: Annotated[float, Interval(ge=0.0, le=10.0)] = _level(
        "dielectric", 0.0, 0.01, 0.005
    )
    """dielectric: loss tangent of the object's material."""
    figure_shell_m: Annotated[float, Interval(ge=0.0, le=0.005)] = _level(
        "dielectric", 0.0, 0.0, 0.0
    )
    """dielectric: thickness of the object's wall, with air inside; 0: solid [m]."""
    wall_bulge_m: ErrorM = _level("bulge", 0.0, 0.001, 0.003)
    """bulge: largest displacement of each wall out of its plane; its edges stay [m]."""
    box_turn_deg: _TurnDeg = _level("turn", 0.0, 1.0, 2.5)
    """turn: of all boxes about the vertical, relative to the capture's record [degrees]."""
    box_skew_deg: _TurnDeg = _level("turn", 0.0, 0.3, 0.6)
    """turn: deviation of the boxes' vertical corners from the right angle [degrees]."""
    wall_loss_db: _MarginDb = _level("turn", 0.0, 0.45, 0.9)
    """turn: loss of one crossing of a wall, beside the reflection of its faces [dB]."""
    edge_energy_fraction: NotNegative = _level("edges", 0.0, 0.02, 0.1)
    """edges: energy of edges and tape of the outermost box over that of the object's echo."""
    leakage_db: _OptionalDb = _level("leakage", -math.inf, 10.0, 25.0)
    """leakage: power from transmitter to receiver over that of all echoes; -inf: none [dB]."""
    channel_gain_rms_db: _MarginDb = _level("channels", 0.0, 0.5, 1.0)
    """channels: unknown gain of each channel, the same in all planes [dB]."""
    channel_phase_rms_deg: _Angle = _level("channels", 0.0, 10.0, 30.0)
    """channels: unknown phase of each channel [degrees]."""
    n_channels: Annotated[int, Interval(ge=1, le=4096)] = _level("channels", 4, 4, 4)
    """channels: their number; antenna i of a plane belongs to channel i modulo this."""
    phase_walk_deg: _Angle = _level("walk", 0.0, 20.0, 40.0)
    """walk: rms difference of the phase at the end of a plane from that at its start [degrees]."""
    random_plane_phase: bool = _level("plane_phase", False, True, True)
    """plane_phase: each plane has a random phase, uniform on the circle."""
    iq_gain_error: Share = _level("iq", 0.0, 0.02, 0.06)
    """iq: share by which Q is stronger than I."""
    iq_phase_error_deg: _Angle = _level("iq", 0.0, 2.0, 5.0)
    """iq: deviation of Q from the right angle to I [degrees]."""
    dc_db: _OptionalDb = _level("iq", -math.inf, -10.0, 0.0)
    """iq: power of a constant offset over that of all echoes; -inf: none [dB]."""
    converter_bits: Annotated[int, Interval(ge=0, le=24)] = _level("quantisation", 0, 14, 12)
    """quantisation: bits of I and of Q, full scale at the capture's peak; 0: not rounded."""
    clip_db: _MarginDb = _level("quantisation", 0.0, 0.0, 0.0)
    """quantisation: level of the peak above full scale, where samples are clipped [dB]."""
    ripple_rms: Share = _level("ripple", 0.0, 0.03, 0.12)
    """ripple: of the complex gain over the chirp, as a share of its mean."""
    position_drift_rms_m: ErrorM = _level("drift", 0.0, 0.0002, 0.0005)
    """drift: slow error of the recorded positions along a plane, per coordinate [m]."""
    plane_angle_rms_deg: _Angle = _level("angles", 0.0, 0.1, 0.3)
    """angles: error of each plane's angle about the turntable's axis [degrees]."""
    axis_offset_m: ErrorM = _level("axis", 0.0, 0.001, 0.002)
    """axis: of the true turntable axis, in equal parts towards the radar and across [m]."""
    axis_tilt_deg: _Angle = _level("tilt", 0.0, 0.1, 0.3)
    """tilt: of the true turntable axis, in equal parts towards the radar and across [degrees]."""
    position_white_rms_m: ErrorM = _level("white", 0.0, 0.00005, 0.0001)
    """white: error of each antenna's recorded position, per coordinate [m]."""
    roughness_rms_m: ErrorM = _level("roughness", 0.0, 0.0001, 0.0003)
    """roughness: rms displacement of the echoing surface, per coordinate [m]."""
    roughness_length_m: LengthM = _level("roughness", 0.003, 0.003, 0.003)
    """roughness: correlation length [m]."""
    patch_loss_db: _MarginDb = _level("patches", 0.0, 3.0, 6.0)
    """patches: reduction of the echo of half of the object's surface, in patches [dB]."""
    patch_length_m: LengthM = _level("patches", 0.02, 0.02, 0.02)
    """patches: their correlation length [m]."""
    pattern_exponent: Annotated[int, Interval(ge=0, le=100)] = _level("gain", 0, 2, 6)
    """gain: n of the amplitude pattern cos^n of each antenna; 0 is isotropic."""

    def __post_init__(self) -> None:
        for effect in self.effects:
            if effect not in EFFECTS:
                hint = nearest_name(effect, EFFECTS) or "; there are " + ", ".join(EFFECTS)
                msg = f"effects has an unknown effect {effect!r}{hint}"
                raise ValueError(msg)
        if self.effects and self.preset == "none":
            msg = f"effects needs preset 'plausible' or 'hard', got {self.effects!r} of 'none'"
            raise ValueError(msg)
        on = self.effects or tuple(name for name in EFFECTS if name not in _NOT_BY_DEFAULT)
        for entry in _effect_fields():
            if getattr(self, entry.name) is _OF_PRESET:
                preset = self.preset if entry.metadata["effect"] in on else "none"
                object.__setattr__(self, entry.name, entry.metadata[preset])
        self._check()

    def _check(self) -> None:
        super().__post_init__()
        if self.figure_permittivity and self.figure_permittivity <= 1.0:
            msg = f"figure_permittivity must be 0 or above 1, got {self.figure_permittivity}"
            raise ValueError(msg)
        if self.figure_shell_m and not self.figure_permittivity:
            msg = f"figure_shell_m needs figure_permittivity, got {self.figure_shell_m} of metal"
            raise ValueError(msg)
        if self.converter_bits and not 2 <= self.converter_bits <= 24:
            msg = f"converter_bits must be 0 or 2 to 24, got {self.converter_bits}"
            raise ValueError(msg)

    @property
    def is_off(self) -> bool:
        """Whether no effect is on."""
        return not self.settings

    @property
    def settings(self) -> dict[str, Any]:
        """Values of this spec that are not off, by name."""
        return {
            entry.name: getattr(self, entry.name)
            for entry in _effect_fields()
            if getattr(self, entry.name) != entry.metadata["none"]
        }

    def __str__(self) -> str:
        """Return the settings on one line."""
        return ", ".join(f"{name} {value:g}" for name, value in self.settings.items())


def _effect_fields() -> list[Field[Any]]:
    """Fields of :class:`WorldSpec` that belong to an effect."""
    return [entry for entry in fields(WorldSpec) if entry.metadata]


EFFECTS = tuple(dict.fromkeys(entry.metadata["effect"] for entry in _effect_fields()))
"""Names of all effects."""
