"""Corrections of a capture as numbers that can be stored and applied again."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from geraf2._types import AnyPath, Array, Floats
from geraf2.calibration.autofocus import with_displacements
from geraf2.calibration.box_search import upward
from geraf2.calibration.channel_phase import channels_of, with_channel_phases
from geraf2.calibration.leakage import Leakage, without_leakage
from geraf2.errors import UserError
from geraf2.io.array_layouts import read_arrays
from geraf2.io.atomic import write_npz_atomic
from geraf2.io.manifest import DELAY_GIVEN, DELAY_KEY
from geraf2.scene import Capture, LosPrior
from geraf2.scene.summary import summarize_capture

_LAYOUTS = {
    "reversed_turn": "int",
    "channel_phases_rad": "float? c",
    "n_turns": "int",
    "delay_m": "float",
    "drift_coefficients_m": "float? p k",
    "prior_to_capture": "float? 4 4",
    "leakage_basis": "complex? s r",
    "leakage_operator": "complex? s r",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Corrections:
    """All corrections of a capture and its prior; None and 0 change nothing."""

    reversed_turn: int = 0
    """1 if the turntable ran in the other sense than recorded, which is corrected first; else 0."""
    leakage: Leakage | None = None
    """Direct leakage between transmitter and receiver."""
    channel_phases_rad: Floats | None = None
    """Phase of each channel, to be removed, (n_channels,) [rad]."""
    n_turns: int = 0
    """Number of interleaved channels; 0: channels are distinguished by their offsets."""
    delay_m: float = 0.0
    """Change of the instrument delay, two-way path [m]."""
    drift_coefficients_m: Floats | None = None
    """Displacement of antennas along the looking direction, splines, (n_poses, n) [m]."""
    prior_to_capture: Floats | None = None
    """Rigid transform of the prior, (4, 4)."""

    @property
    def are_none(self) -> bool:
        """Whether nothing changes, including the prior."""
        return not any(np.any(value) for value in self._arrays().values())

    def applied(self, capture: Capture) -> Capture:
        """Corrected capture; the same object if nothing changes."""
        if self.reversed_turn:
            capture = with_turn_reversed(capture)
        if self.leakage is not None:
            capture = without_leakage(capture, self.leakage)
        if self.channel_phases_rad is not None:
            channels = channels_of(capture.poses, self.n_turns)
            if channels is None:
                raise UserError(what="the antennas' offsets do not distinguish channels")
            capture = with_channel_phases(capture, channels, self.channel_phases_rad)
        if self.delay_m != 0.0:
            capture = with_delay(capture, self.delay_m)
        if self.drift_coefficients_m is not None:
            capture = with_displacements(capture, self.drift_coefficients_m)
        return capture

    def moved_prior(self, prior: LosPrior) -> LosPrior:
        """Prior in the frame of the capture; the same object if it does not move."""
        return prior if self.prior_to_capture is None else prior.move(self.prior_to_capture)

    def _arrays(self) -> dict[str, Array]:
        """All values by name; unchanged ones are empty."""
        nothing = np.zeros(0)
        names = [entry.name for entry in fields(self) if entry.name != "leakage"]
        values = {name: getattr(self, name) for name in names}
        arrays: dict[str, Array] = {
            k: nothing if v is None else np.asarray(v) for k, v in values.items()
        }
        own = self.leakage or Leakage()
        arrays["leakage_basis"] = nothing if own.basis is None else own.basis
        arrays["leakage_operator"] = nothing if own.operator is None else own.operator
        return arrays

    def save(self, path: AnyPath) -> None:
        """Write `calibration.npz`."""
        write_npz_atomic(path, self._arrays())

    @classmethod
    def load(cls, path: AnyPath) -> "Corrections":
        """Read a file written by `save`; UserError for any other file."""
        arrays = read_arrays(path, _LAYOUTS)
        names = (entry.name for entry in fields(cls) if entry.name != "leakage")
        values: dict[str, Any] = {k: arrays[k] if arrays[k].size else None for k in names}
        values |= {"n_turns": int(arrays["n_turns"]), "delay_m": float(arrays["delay_m"])}
        values |= {"reversed_turn": int(arrays["reversed_turn"])}
        basis, operator = arrays["leakage_basis"], arrays["leakage_operator"]
        if basis.shape != operator.shape:
            raise UserError(what="leakage_basis and leakage_operator differ in shape", where=path)
        leakage = Leakage(basis=basis, operator=operator) if basis.size else None
        return cls(leakage=leakage, **values)


def with_delay(capture: Capture, change_m: float) -> Capture:
    """Capture with a known delay, changed by `change_m` on the two-way path [m]."""
    bias = float(capture.waveform.path_bias_m + change_m)
    return replace(
        capture,
        waveform=replace(capture.waveform, path_bias_m=bias),
        provenance={**capture.provenance, DELAY_KEY: DELAY_GIVEN},
    )


def with_turn_reversed(capture: Capture) -> Capture:
    """Capture whose turntable ran in the other sense: planes at the angles -a instead of a.

    Angles are about the upright axis through the point that the planes face, 0 towards x, or
    towards y for a turntable whose axis is x.
    """
    point, up = summarize_capture(capture).focus, upward(capture)
    assert point is not None
    x = np.roll(np.eye(3), -1, axis=0)[int(np.abs(up).argmax())]
    y = np.cross(up, x)
    poses = []
    for pose in capture.poses:
        outward = (pose.phase_centers if pose.n_antennas else point[None]).mean(axis=0) - point
        angle = float(np.arctan2(outward @ y, outward @ x))
        turn = Rotation.from_rotvec(-2.0 * angle * up).as_matrix()
        tx, rx = ((p - point) @ turn.T + point for p in (pose.tx_positions, pose.rx_positions))
        axes = np.asarray(pose.axes @ turn.T)
        poses.append(replace(pose, tx_positions=tx, rx_positions=rx, axes=axes))
    return replace(capture, poses=tuple(poses))
