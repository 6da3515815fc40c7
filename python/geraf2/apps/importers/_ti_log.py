"""Calls in LogFile.txt of mmWave Studio, and in scripts (Lua, MATLAB, JavaScript, Python).

    25-Oct-2018 12:03:07: API:ProfileConfig,0,1435384036,10000,600,6000,0,0,1243,0,256,10000,...
    ar1.ProfileConfig(0, 77, 100, 6, 60, 0, 0, 0, 0, 0, 0, 60.012, 0, 256, 10000, 0, 0, 30)

A line 'API:' holds values in steps of the chip; a line 'ar1.' holds typed values. Order
and units are those of TI's mmWave Studio user guide (ar1 calls) and of its mmWaveLink reference
(rlProfileCfg_t, rlChirpCfg_t, rlFrameCfg_t, rlAdcOutCfg_t, rlDevDataFmtCfg_t), in
https://software-dl.ti.com/ra-processors/esd/MMWAVE-DFP-2G/. The last
of repeated calls is valid; in a script with branches, calls of different values are refused.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geraf2.apps.importers import _ti_values as ti
from geraf2.errors import UserError

# Steps of the chip: of a 2^26 part of 3.6 GHz (77 GHz devices) or 2.7 GHz (60 GHz devices).
_STEP_77_HZ, _STEP_60_HZ = 3.6e9 / 2**26, 2.7e9 / 2**26
# One step of the slope is 900 steps of the frequency in a millisecond, 48.279 kHz/us at 77 GHz.
_SLOPE_STEPS_HZ_PER_S = 900 * 1e6
_TIME_STEP_S, _FRAME_STEP_S = 1e-8, 5e-9
# 77 GHz devices sweep up to here; a code beyond is of a 60 GHz device.
_HIGHEST_HZ = 81.1e9
_DEVICE_60 = re.compile(r"[AI]WR\W*(?:68|64)\d\d|XWR\W*(?:68|64)\w\w|\b60G\b", re.IGNORECASE)
_LOG_CALL = re.compile(r"\bAPI:[^\S\n]*(\w+)[^\S\n]*,(.*)$", re.MULTILINE)
_SCRIPT_CALL = re.compile(r"\bar1\.(\w+)\s*\(([^()]*)\)")
# Comments of each language; three dots continue a line of MATLAB.
_COMMENTS = {
    ".m": r"^\s*%\{.*?^\s*%\}|%[^\n]*|\.\.\.",
    ".js": r"/\*.*?\*/|//[^\n]*",
    ".py": r"#[^\n]*",
}
_LUA_COMMENTS = r"--\[\[.*?\]\]|--[^\n]*"
_BRANCH = re.compile(r"^\s*(?:\}\s*)?(?:if|else\s*if|elseif|elif|else|switch|case)\b", re.MULTILINE)
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
    "BpmChirpConfig": (3, 8),
}
# Most arguments in a script: newer chips have more transmitters, and others follow.
_MAX_VALUES = {"ProfileConfig": 18, "ChirpConfig": 10}
# Number of arguments that name what a call configures: a profile, or a range of chirps.
_N_KEYS = {"ProfileConfig": 1, "ChirpConfig": 2, "BpmChirpConfig": 2}


@dataclass(frozen=True, kw_only=True)
class _Call:
    name: str
    where: str
    raw: bool
    """Whether the values are in steps of the chip."""
    values: list[float]


def has_calls(text: str) -> bool:
    """Whether a text is a log or a script with calls that are read."""
    found = (*_LOG_CALL.finditer(text), *_SCRIPT_CALL.finditer(text))
    return any(match[1] in _LENGTHS for match in found)


def read_log(text: str, path: Path) -> ti.TiConfig:
    """Values of the last calls of a log or a script; UserError names a line that cannot be read."""
    calls = _calls(text, path)
    last = {call.name: call for call in calls}
    if "ProfileConfig" not in last:
        raise UserError(
            what="is no log of mmWave Studio",
            where=path,
            expected="a line with API:ProfileConfig, or ar1.ProfileConfig(...)",
        )
    known = _profile(_used_profile(calls, last, path), text)
    # In a call the transmitters' mask precedes that of the receivers.
    if "ChanNAdcConfig" in last:
        values = last["ChanNAdcConfig"].values
        rx_mask, codes = _mask(values[3:7]), values[7:9]
    else:
        rx_mask = int(last["ChannelConfig"].values[1]) if "ChannelConfig" in last else 0
        codes = last["AdcOutConfig"].values if "AdcOutConfig" in last else []
    n_lanes = 0
    if "LVDSLaneConfig" in last:
        n_lanes = _mask(last["LVDSLaneConfig"].values[1:5]).bit_count()
    elif "LaneConfig" in last:
        n_lanes = int(last["LaneConfig"].values[0]).bit_count()
        n_lanes = n_lanes if n_lanes in (2, 4) else 0
    known |= {
        "n_rx": rx_mask.bit_count() if rx_mask else None,
        "n_lanes": n_lanes or None,
        "is_real": ti.is_real_16(codes[0], codes[1], path) if codes else None,
    }
    if "DataFmtConfig" in last:
        known["interleaved"] = last["DataFmtConfig"].values[4] == 0
    if "FrameConfig" in last:
        frame = last["FrameConfig"]
        first, stop, n_frames, n_loops = (int(value) for value in frame.values[:4])
        chirps = _chirps(calls, "ChirpConfig", slice(7, 10))
        codes_of = _chirps(calls, "BpmChirpConfig", slice(2, 8))
        turned = [(start, end, ti.bpm_mask(code)) for start, end, code in codes_of]
        known |= {
            "transmitters": ti.transmitters_of(chirps, first, stop, path, turned),
            "n_chirps_per_frame": (stop - first + 1) * n_loops,
            "n_frames": n_frames or None,
            "frame_period_s": frame.values[4] * (_FRAME_STEP_S if frame.raw else 1e-3),
        }
    return ti.TiConfig(**known)


def _calls(text: str, path: Path) -> list[_Call]:
    """Return the calls in their order in the file."""
    pattern = _COMMENTS.get(path.suffix.lower(), _LUA_COMMENTS)
    # Line ends of comments keep the numbers of the lines.
    script = re.sub(f"(?ms){pattern}", lambda found: "\n" * found[0].count("\n") or " ", text)
    found = [(match.start(), True, match) for match in _LOG_CALL.finditer(script)]
    found += [(match.start(), False, match) for match in _SCRIPT_CALL.finditer(script)]
    calls = []
    for start, raw, match in sorted(found, key=lambda entry: entry[0]):
        name, arguments = match[1], match[2]
        if name not in _LENGTHS:
            continue
        where = f"{path}, line {script.count(chr(10), 0, start) + 1}"
        wanted = _LENGTHS[name][0 if raw else 1]
        words = [word.strip() for word in arguments.strip().rstrip(",").split(",")]
        most = len(words) if raw else _MAX_VALUES.get(name, len(words))
        ti.require_count(name, len(words), wanted, max(most, wanted), where)
        values = [ti.to_number(word, name, where) for word in words[:wanted]]
        calls.append(_Call(name=name, where=where, raw=raw, values=values))
    if _BRANCH.search(script):
        _require_one_branch([call for call in calls if not call.raw])
    return calls


def _require_one_branch(calls: list[_Call]) -> None:
    """Raise UserError where calls of one thing differ, of which only one branch is run."""
    first: dict[tuple[Any, ...], _Call] = {}
    for call in calls:
        before = first.setdefault((call.name, *call.values[: _N_KEYS.get(call.name, 0)]), call)
        pairs = zip(before.values, call.values, strict=True)
        differing = [(a, b) for a, b in pairs if a != b]
        if differing:
            a, b = (", ".join(f"{pair[side]:g}" for pair in differing) for side in range(2))
            raise UserError(
                what=f"{call.name} differs from that of line {before.where.rsplit(' ', 1)[1]}, and "
                "branches of the script decide which one is run",
                where=call.where,
                expected=a,
                got=b,
                hint="delete the branches of other chips, or give the parameters in --radar",
            )


def _used_profile(calls: list[_Call], last: dict[str, _Call], path: Path) -> _Call:
    """Last profile that the chirps name; the last of all where they name none."""
    used = {call.values[2] for call in calls if call.name == "ChirpConfig"}
    profiles = [call for call in calls if call.name == "ProfileConfig"]
    if len(used) > 1 and len({call.values[0] for call in profiles}) > 1:
        raise UserError(
            what=f"chirps of {len(used)} profiles alternate", where=path, expected="one profile"
        )
    named = [call for call in profiles if call.values[0] in used]
    return named[-1] if named else last["ProfileConfig"]


def _profile(call: _Call, text: str) -> dict[str, Any]:
    if not call.raw:
        return ti.profile_values(call.values, (1, 3, 11, 13, 14))
    of_60 = _DEVICE_60.search(text) is not None or call.values[1] * _STEP_77_HZ > _HIGHEST_HZ
    step = _STEP_60_HZ if of_60 else _STEP_77_HZ
    return ti.profile_values(
        call.values, (1, 3, 7, 9, 10), (step, _TIME_STEP_S, step * _SLOPE_STEPS_HZ_PER_S)
    )


def _chirps(calls: list[_Call], name: str, at: slice) -> list[tuple[int, int, int]]:
    """First and last chirp, and mask, of each call, the last first; `at`: bits in a script."""
    return [
        (
            int(call.values[0]),
            int(call.values[1]),
            int(call.values[at.start]) if call.raw else _mask(call.values[at]),
        )
        for call in reversed(calls)
        if call.name == name
    ]


def _mask(flags: list[float]) -> int:
    return sum(1 << bit for bit, flag in enumerate(flags) if flag)
