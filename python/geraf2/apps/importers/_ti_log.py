"""Calls in LogFile.txt of mmWave Studio, and in its Lua scripts.

    25-Oct-2018 12:03:07: API:ProfileConfig,0,1435384036,10000,600,6000,0,0,1243,0,256,10000,...
    ar1.ProfileConfig(0, 77, 100, 6, 60, 0, 0, 0, 0, 0, 0, 60.012, 0, 256, 10000, 0, 0, 30)

A line 'API:' holds what goes to the chip, in its steps; a line 'ar1.' what a person typed. Order
and units are those of TI's mmWave Studio user guide (ar1 calls) and of its mmWaveLink reference
(rlProfileCfg_t, rlChirpCfg_t, rlFrameCfg_t, rlAdcOutCfg_t, rlDevDataFmtCfg_t), in
https://software-dl.ti.com/ra-processors/esd/MMWAVE-DFP-2G/. A call that comes again goes before
what it said first.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from geraf2.errors import UserError

# Steps of the chip: of a 2^26 part of 3.6 GHz (77 GHz devices) or 2.7 GHz (60 GHz devices).
_STEP_77_HZ, _STEP_60_HZ = 3.6e9 / 2**26, 2.7e9 / 2**26
# One step of the slope is 900 steps of the frequency in a millisecond, 48.279 kHz/us at 77 GHz.
_SLOPE_STEPS_HZ_PER_S = 900 * 1e6
_TIME_STEP_S, _FRAME_STEP_S = 1e-8, 5e-9
# 77 GHz devices sweep up to here; a code beyond is of a 60 GHz device.
_HIGHEST_HZ = 81.1e9
_DEVICE_60 = re.compile(r"[AI]WR\W*(?:68|64)\d\d|XWR\W*(?:68|64)\w\w|\b60G\b", re.IGNORECASE)
_CALL = re.compile(r"\bAPI:\s*(\w+)\s*,(.*)$|\bar1\.(\w+)\s*\(([^()]*)\)")
# Arguments that are read of each call, in the log and in a script.
_LENGTHS = {
    "ProfileConfig": (11, 15),
    "ChirpConfig": (8, 10),
    "FrameConfig": (5, 5),
    "AdcOutConfig": (2, 2),
    "ChannelConfig": (2, 2),
    "DataFmtConfig": (5, 5),
    "LaneConfig": (1, 1),
    "ChanNAdcConfig": (9, 9),
    "LVDSLaneConfig": (5, 5),
}


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Chirp of a log, in SI units."""

    start_hz: float
    adc_start_s: float
    slope_hz_per_s: float
    n_samples: int
    sample_rate_hz: float


@dataclass(frozen=True, kw_only=True)
class Frame:
    """Frame of a log, in SI units."""

    first_chirp: int
    last_chirp: int
    n_frames: int
    n_loops: int
    period_s: float


@dataclass(frozen=True, kw_only=True)
class LogCalls:
    """What the last calls of a log say."""

    profile: Profile
    frame: Frame | None
    chirps: list[tuple[int, int, int]]
    """First and last index and mask of transmitters; the latest first."""
    adc_format: tuple[float, float] | None
    """Codes of bits (2 is 16) and of the output (0 is real)."""
    rx_mask: int | None
    n_lanes: int | None
    interleaved: bool | None
    """Whether receivers alternate from sample to sample."""


@dataclass(frozen=True, kw_only=True)
class _Call:
    name: str
    where: str
    raw: bool
    """Whether it is in steps of the chip."""
    values: list[float]


def read_log_calls(text: str, path: Path) -> LogCalls:
    """Read a log or a script; UserError names a line that cannot be read."""
    calls = list(_calls(text, path))
    last = {call.name: call for call in calls}
    if "ProfileConfig" not in last:
        raise UserError(
            what="is no log of mmWave Studio",
            where=path,
            expected="a line with API:ProfileConfig, or ar1.ProfileConfig(...)",
        )
    return LogCalls(
        profile=_profile(last["ProfileConfig"], text),
        frame=_frame(last["FrameConfig"]) if "FrameConfig" in last else None,
        chirps=[_chirp(call) for call in reversed(calls) if call.name == "ChirpConfig"],
        adc_format=_adc_format(last),
        rx_mask=_rx_mask(last),
        n_lanes=_n_lanes(last),
        interleaved=last["DataFmtConfig"].values[4] == 0 if "DataFmtConfig" in last else None,
    )


def _calls(text: str, path: Path) -> Iterator[_Call]:
    for number, line in enumerate(text.splitlines(), start=1):
        if line.lstrip().startswith("--"):  # a comment in Lua
            continue
        for match in _CALL.finditer(line):
            raw = match[1] is not None
            name, arguments = (match[1], match[2]) if raw else (match[3], match[4])
            if name not in _LENGTHS:
                continue
            where = f"{path}, line {number}"
            wanted = _LENGTHS[name][0 if raw else 1]
            words = [word.strip() for word in arguments.split(",")][:wanted]
            if len(words) < wanted or not words[-1]:
                raise UserError(
                    what=f"{name} has too few values",
                    where=where,
                    expected=f"{wanted} or more",
                    got=len([word for word in words if word]),
                )
            yield _Call(name=name, where=where, raw=raw, values=[_number(w, where) for w in words])


def _number(word: str, where: str) -> float:
    try:
        value = float(int(word, 16)) if word.lower().startswith("0x") else float(word)
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e15:
        raise UserError(what="must be a number", where=where, got=repr(word)[:60])
    return value


def _profile(call: _Call, text: str) -> Profile:
    values = call.values
    if not call.raw:
        return Profile(
            start_hz=1e9 * values[1],
            adc_start_s=1e-6 * values[3],
            slope_hz_per_s=1e12 * values[11],
            n_samples=int(values[13]),
            sample_rate_hz=1e3 * values[14],
        )
    of_60 = _DEVICE_60.search(text) is not None or values[1] * _STEP_77_HZ > _HIGHEST_HZ
    step = _STEP_60_HZ if of_60 else _STEP_77_HZ
    return Profile(
        start_hz=step * values[1],
        adc_start_s=_TIME_STEP_S * values[3],
        slope_hz_per_s=step * _SLOPE_STEPS_HZ_PER_S * values[7],
        n_samples=int(values[9]),
        sample_rate_hz=1e3 * values[10],
    )


def _frame(call: _Call) -> Frame:
    first, last, n_frames, n_loops, period = call.values
    return Frame(
        first_chirp=int(first),
        last_chirp=int(last),
        n_frames=int(n_frames),
        n_loops=int(n_loops),
        period_s=period * (_FRAME_STEP_S if call.raw else 1e-3),
    )


def _chirp(call: _Call) -> tuple[int, int, int]:
    first, last = (int(value) for value in call.values[:2])
    if call.raw:
        return first, last, int(call.values[7])
    return first, last, sum(1 << bit for bit, flag in enumerate(call.values[7:10]) if flag)


def _adc_format(last: dict[str, _Call]) -> tuple[float, float] | None:
    if "ChanNAdcConfig" in last:
        return last["ChanNAdcConfig"].values[7], last["ChanNAdcConfig"].values[8]
    if "AdcOutConfig" in last:
        return last["AdcOutConfig"].values[0], last["AdcOutConfig"].values[1]
    return None


def _rx_mask(last: dict[str, _Call]) -> int | None:
    """Receivers that are on; the log has the mask of the transmitters before theirs."""
    if "ChanNAdcConfig" in last:
        flags = last["ChanNAdcConfig"].values[3:7]
        return sum(1 << bit for bit, flag in enumerate(flags) if flag)
    if "ChannelConfig" in last:
        return int(last["ChannelConfig"].values[1])
    return None


def _n_lanes(last: dict[str, _Call]) -> int | None:
    if "LVDSLaneConfig" in last:
        return int(sum(flag != 0 for flag in last["LVDSLaneConfig"].values[1:5])) or None
    if "LaneConfig" in last:
        lanes = int(last["LaneConfig"].values[0]).bit_count()
        return lanes if lanes in (2, 4) else None
    return None
