"""Calls in LogFile.txt of mmWave Studio, and in its Lua scripts.

    25-Oct-2018 12:03:07: API:ProfileConfig,0,1435384036,10000,600,6000,0,0,1243,0,256,10000,...
    ar1.ProfileConfig(0, 77, 100, 6, 60, 0, 0, 0, 0, 0, 0, 60.012, 0, 256, 10000, 0, 0, 30)

A line 'API:' holds values in steps of the chip; a line 'ar1.' holds typed values. Order
and units are those of TI's mmWave Studio user guide (ar1 calls) and of its mmWaveLink reference
(rlProfileCfg_t, rlChirpCfg_t, rlFrameCfg_t, rlAdcOutCfg_t, rlDevDataFmtCfg_t), in
https://software-dl.ti.com/ra-processors/esd/MMWAVE-DFP-2G/. The last
of repeated calls is valid.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geraf2.apps.importers._ti_values import TiConfig, n_transmitters, ones, require_complex_16
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
# Number of arguments read of each call, in the log and in a script.
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
class _Call:
    name: str
    where: str
    raw: bool
    """Whether the values are in steps of the chip."""
    values: list[float]


def read_log(text: str, path: Path) -> TiConfig:
    """Values of the last calls of a log or a script; UserError names a line that cannot be read."""
    calls = list(_calls(text, path))
    last = {call.name: call for call in calls}
    if "ProfileConfig" not in last:
        raise UserError(
            what="is no log of mmWave Studio",
            where=path,
            expected="a line with API:ProfileConfig, or ar1.ProfileConfig(...)",
        )
    if (codes := _adc_format(last)) is not None:
        require_complex_16(*codes, path)
    rx_mask = _rx_mask(last)
    known: dict[str, Any] = {
        **_profile(last["ProfileConfig"], text),
        "n_rx": ones(rx_mask) if rx_mask else None,
        "n_lanes": _n_lanes(last),
    }
    if "DataFmtConfig" in last:
        known["interleaved"] = last["DataFmtConfig"].values[4] == 0
    if "FrameConfig" in last:
        frame = last["FrameConfig"]
        first, stop, n_frames, n_loops = (int(value) for value in frame.values[:4])
        chirps = [_chirp(call) for call in reversed(calls) if call.name == "ChirpConfig"]
        known |= {
            "n_tx": n_transmitters(chirps, first, stop, path),
            "n_chirps_per_frame": (stop - first + 1) * n_loops,
            "n_frames": n_frames or None,
            "frame_period_s": frame.values[4] * (_FRAME_STEP_S if frame.raw else 1e-3),
        }
    return TiConfig(**known)


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


def _profile(call: _Call, text: str) -> dict[str, Any]:
    """Values of a chirp, in SI units."""
    values = call.values
    if not call.raw:
        return {
            "ramp_start_hz": 1e9 * values[1],
            "adc_start_s": 1e-6 * values[3],
            "chirp_slope_hz_per_s": 1e12 * values[11],
            "n_samples": int(values[13]),
            "sample_rate_hz": 1e3 * values[14],
        }
    of_60 = _DEVICE_60.search(text) is not None or values[1] * _STEP_77_HZ > _HIGHEST_HZ
    step = _STEP_60_HZ if of_60 else _STEP_77_HZ
    return {
        "ramp_start_hz": step * values[1],
        "adc_start_s": _TIME_STEP_S * values[3],
        "chirp_slope_hz_per_s": step * _SLOPE_STEPS_HZ_PER_S * values[7],
        "n_samples": int(values[9]),
        "sample_rate_hz": 1e3 * values[10],
    }


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
    """Mask of the active receivers; the transmitters' mask precedes it in a call."""
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
