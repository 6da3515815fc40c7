"""Radar parameters from the files of TI's own software: mmWave Studio, DCA1000 CLI, SDK profile.

    *.mmwave.json   mmWave Studio: mmWaveDevices[].rfConfig.rlProfiles[].rlProfileCfg_t ...
    cf.json         DCA1000 command line: DCA1000Config.lvdsMode ...
    *.cfg           mmWave SDK: lines 'profileCfg ...', 'chirpCfg ...', 'frameCfg ...'
    *LogFile.txt    mmWave Studio: lines 'API:ProfileConfig,...', and its scripts (_ti_log)

The names and units of the keys are those of TI's mmWave Studio and SDK user guides.
"""

import json
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from geraf2.apps.importers._ti_log import read_log_calls
from geraf2.errors import UserError

# Values that a log rounds to the steps of the chip: 0.048 MHz/us of slope, 54 Hz, 10 ns.
_CLOSE = {"chirp_slope_hz_per_s": 1e-2, "adc_start_s": 1e-2}


@dataclass(frozen=True, kw_only=True)
class TiConfig:
    """What a configuration file says; None where it says nothing."""

    ramp_start_hz: float | None = None
    adc_start_s: float | None = None
    chirp_slope_hz_per_s: float | None = None
    sample_rate_hz: float | None = None
    n_samples: int | None = None
    n_rx: int | None = None
    n_tx: int | None = None
    """Transmitters that take turns."""
    n_chirps_per_frame: int | None = None
    n_frames: int | None = None
    """Frames to record; None also where it goes on until it is stopped."""
    frame_period_s: float | None = None
    n_lanes: int | None = None
    interleaved: bool | None = None
    """Whether receivers alternate from sample to sample."""

    def first_sample_hz(self) -> float | None:
        """Frequency of the first sample: start + slope x ADC start."""
        if self.ramp_start_hz is None or self.chirp_slope_hz_per_s is None:
            return None
        return self.ramp_start_hz + self.chirp_slope_hz_per_s * (self.adc_start_s or 0.0)


def read_ti_configs(paths: Iterable[Path]) -> TiConfig:
    """Read configuration files of one recording; a value given twice must be the same."""
    known: dict[str, Any] = {}
    said_by: dict[str, Path] = {}
    for path in paths:
        config = _read_one(path)
        for field in fields(config):
            value = getattr(config, field.name)
            if value is None:
                continue
            before = known.get(field.name)
            close = _CLOSE.get(field.name, 1e-6)
            if before is not None and not math.isclose(before, value, rel_tol=close):
                raise UserError(
                    what=f"contradicts {said_by[field.name]} on {field.name}",
                    where=path,
                    expected=before,
                    got=value,
                )
            if before is None:
                known[field.name], said_by[field.name] = value, path
    return TiConfig(**known)


def find_ti_configs(source: Path) -> list[Path]:
    """Find configuration files in the folder of a recording; of a file, the log of its name."""
    if source.is_file():
        stem = re.sub(r"_Raw_\d+$", "", source.stem, flags=re.IGNORECASE)
        found = [source.with_name(f"{stem}_LogFile.txt")]
    else:
        patterns = ("*.mmwave.json", "*cf.json", "*.cfg", "*LogFile.txt")
        # Logs come last: of values that are the same to within their steps, the first is taken.
        found = [path for pattern in patterns for path in sorted(source.glob(pattern))]
    # A log of a session in which nothing was set up says nothing.
    return [
        path
        for path in found
        if path.is_file() and (path.suffix != ".txt" or b"ProfileConfig" in path.read_bytes())
    ]


def _read_one(path: Path) -> TiConfig:
    if not path.is_file():
        raise UserError(what="no such file", where=path)
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UserError(what=f"is not text in UTF-8 (byte {error.start})", where=path) from None
    if path.suffix.lower() == ".cfg":
        return _from_profile(text, path)
    if path.suffix.lower() in (".txt", ".lua"):
        return _from_log(text, path)
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UserError(what=f"is not valid JSON: {error}", where=path) from None
    if isinstance(values, dict) and "mmWaveDevices" in values:
        return _from_studio(values, path)
    if isinstance(values, dict) and "DCA1000Config" in values:
        return _from_capture_card(values["DCA1000Config"], path)
    raise UserError(
        what="is no configuration of a TI radar",
        where=path,
        expected="mmWaveDevices (mmWave Studio), DCA1000Config, a .cfg profile, or LogFile.txt",
    )


class _Table:
    """Values of a JSON object, with messages that name the key."""

    def __init__(self, values: Any, name: str, path: Path) -> None:
        if not isinstance(values, Mapping):
            raise UserError(what=f"key {name!r} is missing or no object", where=path)
        self._values, self._name, self._path = values, name, path

    def table(self, key: str) -> "_Table":
        return _Table(self._values.get(key), f"{self._name}.{key}", self._path)

    def tables(self, key: str, inner: str) -> list["_Table"]:
        """Objects `inner` of the list `key`; entries without it are left out."""
        entries = self._values.get(key)
        if not isinstance(entries, list):
            raise UserError(
                what=f"key '{self._name}.{key}' is missing or no list", where=self._path
            )
        return [
            _Table(entry[inner], f"{self._name}.{key}[{number}].{inner}", self._path)
            for number, entry in enumerate(entries)
            if isinstance(entry, Mapping) and inner in entry
        ]

    def has(self, key: str) -> bool:
        return key in self._values

    def number(self, key: str) -> float:
        value = self._values.get(key)
        return to_number(value, f"{self._name}.{key}", self._path)


def to_number(value: Any, name: str, path: Path) -> float:
    """Read a finite number from JSON or text, hexadecimal too; a UserError names its key."""
    try:
        if isinstance(value, str) and value.strip().lower().startswith("0x"):
            return float(int(value, 16))
        if isinstance(value, (int, float, str)) and not isinstance(value, bool):
            number = float(value)
            if math.isfinite(number):
                return number
    except (ValueError, OverflowError):
        pass
    raise UserError(what=f"{name!r} must be a number", where=path, got=repr(value)[:60])


def _ones(mask: float) -> int:
    return int(mask).bit_count()


def _from_studio(values: Mapping[str, Any], path: Path) -> TiConfig:
    devices = values["mmWaveDevices"]
    if not isinstance(devices, list) or len(devices) != 1:
        raise UserError(
            what="must describe one radar device",
            where=path,
            got=len(devices) if isinstance(devices, list) else type(devices).__name__,
        )
    device = _Table(devices[0], "mmWaveDevices[0]", path)
    rf = device.table("rfConfig")
    profiles = rf.tables("rlProfiles", "rlProfileCfg_t")
    if not profiles:
        raise UserError(what="has no rlProfileCfg_t", where=path)
    chirps, frame = rf.tables("rlChirps", "rlChirpCfg_t"), rf.table("rlFrameCfg_t")
    used = {int(chirp.number("profileId")) for chirp in chirps if chirp.has("profileId")}
    if len(used) > 1:
        raise UserError(
            what=f"chirps of {len(used)} profiles alternate", where=path, expected="one profile"
        )
    profile = next(
        (p for p in profiles if p.has("profileId") and int(p.number("profileId")) in used),
        profiles[0],
    )
    table = [
        (int(c.number("chirpStartIdx")), int(c.number("chirpEndIdx")), int(c.number("txEnable")))
        for c in chirps
    ]
    first, last = int(frame.number("chirpStartIdx")), int(frame.number("chirpEndIdx"))
    n_tx = _n_transmitters(table, first, last, path)
    n_frames = int(frame.number("numFrames"))
    lanes, interleaved = None, None
    if device.has("rawDataCaptureConfig"):
        raw = device.table("rawDataCaptureConfig")
        if raw.has("rlDevLaneEnable_t"):
            lanes = _ones(raw.table("rlDevLaneEnable_t").number("laneEn"))
        if raw.has("rlDevDataFmtCfg_t"):
            interleaved = raw.table("rlDevDataFmtCfg_t").number("chInterleave") == 0
    channels = rf.table("rlChanCfg_t") if rf.has("rlChanCfg_t") else None
    if rf.has("rlAdcOutCfg_t"):
        out = rf.table("rlAdcOutCfg_t").table("fmt")
        _require_complex_16(out.number("b2AdcBits"), out.number("b2AdcOutFmt"), path)
    return TiConfig(
        ramp_start_hz=1e9 * profile.number("startFreqConst_GHz"),
        adc_start_s=1e-6 * profile.number("adcStartTimeConst_usec"),
        chirp_slope_hz_per_s=1e12 * profile.number("freqSlopeConst_MHz_usec"),
        sample_rate_hz=1e3 * profile.number("digOutSampleRate"),
        n_samples=int(profile.number("numAdcSamples")),
        n_rx=_ones(channels.number("rxChannelEn")) if channels else None,
        n_tx=n_tx,
        n_chirps_per_frame=(last - first + 1) * int(frame.number("numLoops")),
        n_frames=n_frames or None,
        frame_period_s=1e-3 * frame.number("framePeriodicity_msec"),
        n_lanes=lanes,
        interleaved=interleaved,
    )


def _n_transmitters(
    chirps: list[tuple[int, int, int]], first: int, last: int, path: Path
) -> int | None:
    """Length of the turn in which transmitters alternate, chirps (start, end, mask)."""
    if last < first:
        raise UserError(what="chirpEndIdx of the frame lies before chirpStartIdx", where=path)
    masks = [
        next((mask for start, end, mask in chirps if start <= index <= end), None)
        for index in range(first, last + 1)
    ]
    if not chirps or None in masks:
        return None
    return len(masks) if len(set(masks)) > 1 else 1


def _require_complex_16(bits: float, output: float, path: Path) -> None:
    if bits != 2:
        raise UserError(what="samples are not of 16 bits", where=path, expected=2, got=int(bits))
    if output == 0:
        raise UserError(
            what="samples are real", where=path, expected="complex samples (output format 1)"
        )


def _from_capture_card(values: Any, path: Path) -> TiConfig:
    table = _Table(values, "DCA1000Config", path)
    bits = {1: 12, 2: 14, 3: 16}.get(int(table.number("dataFormatMode")))
    if bits != 16:
        raise UserError(what="samples are not of 16 bits", where=path, expected=16, got=bits)
    lanes = {1: 4, 2: 2}.get(int(table.number("lvdsMode")))
    if lanes is None:
        raise UserError(
            what="lvdsMode is not known", where=path, expected="1 (4 lanes) or 2 (2 lanes)"
        )
    return TiConfig(n_lanes=lanes)


# Numbers that a line of a profile needs at least.
_LINE_LENGTHS = {"profileCfg": 11, "frameCfg": 5, "chirpCfg": 8, "channelCfg": 2, "adcCfg": 2}


def _from_profile(text: str, path: Path) -> TiConfig:
    lines: dict[str, list[list[float]]] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        name, *words = line.split("%", 1)[0].split() or [""]
        if name not in _LINE_LENGTHS:
            continue
        values = [to_number(word, f"line {number}, {name}", path) for word in words]
        if len(values) < _LINE_LENGTHS[name]:
            raise UserError(
                what=f"line {number}: {name} has too few values",
                where=path,
                expected=f"{_LINE_LENGTHS[name]} or more",
                got=len(values),
            )
        lines.setdefault(name, []).append(values)
    if len(lines.get("profileCfg", [])) != 1:
        raise UserError(
            what="must have one line profileCfg", where=path, got=len(lines.get("profileCfg", []))
        )
    (profile,) = lines["profileCfg"]
    frame = lines.get("frameCfg", [[]])[-1]
    channel = lines.get("channelCfg", [[]])[-1]
    if "adcCfg" in lines:
        _require_complex_16(lines["adcCfg"][-1][0], lines["adcCfg"][-1][1], path)
    chirps = [(int(c[0]), int(c[1]), int(c[7])) for c in lines.get("chirpCfg", [])]
    n_tx = _n_transmitters(chirps, int(frame[0]), int(frame[1]), path) if frame else None
    return TiConfig(
        ramp_start_hz=1e9 * profile[1],
        adc_start_s=1e-6 * profile[3],
        chirp_slope_hz_per_s=1e12 * profile[7],
        n_samples=int(profile[9]),
        sample_rate_hz=1e3 * profile[10],
        n_rx=_ones(channel[0]) if channel else None,
        n_tx=n_tx,
        n_chirps_per_frame=int(frame[1] - frame[0] + 1) * int(frame[2]) if frame else None,
        n_frames=(int(frame[3]) or None) if frame else None,
        frame_period_s=1e-3 * frame[4] if frame else None,
    )


def _from_log(text: str, path: Path) -> TiConfig:
    """Read the last of each call in a log of mmWave Studio, or in one of its scripts."""
    log = read_log_calls(text, path)
    profile, frame = log.profile, log.frame
    if log.adc_format is not None:
        _require_complex_16(*log.adc_format, path)
    first, last = (frame.first_chirp, frame.last_chirp) if frame else (0, 0)
    return TiConfig(
        ramp_start_hz=profile.start_hz,
        adc_start_s=profile.adc_start_s,
        chirp_slope_hz_per_s=profile.slope_hz_per_s,
        sample_rate_hz=profile.sample_rate_hz,
        n_samples=profile.n_samples,
        n_rx=_ones(log.rx_mask) if log.rx_mask else None,
        n_tx=_n_transmitters(log.chirps, first, last, path) if frame else None,
        n_chirps_per_frame=(last - first + 1) * frame.n_loops if frame else None,
        n_frames=(frame.n_frames or None) if frame else None,
        frame_period_s=frame.period_s if frame else None,
        n_lanes=log.n_lanes,
        interleaved=log.interleaved,
    )
