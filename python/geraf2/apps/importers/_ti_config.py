"""Radar parameters from the files of TI's own software: mmWave Studio, DCA1000 CLI, SDK profile.

    *.mmwave.json   mmWave Studio: mmWaveDevices[].rfConfig.rlProfiles[].rlProfileCfg_t ...
    cf.json         DCA1000 command line: DCA1000Config.lvdsMode ...
    *.cfg           mmWave SDK: lines 'profileCfg ...', 'chirpCfg ...', 'frameCfg ...'
    *.xml           mmWave Studio: its settings, sections 'apiname_profile_cfg' ...
    *LogFile.txt    mmWave Studio: lines 'API:ProfileConfig,...', and its scripts (_ti_log)

The names and units of the keys are those of TI's mmWave Studio and SDK user guides.
"""

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from geraf2.apps.importers import _ti_values as ti
from geraf2.apps.importers._ti_log import has_calls, read_log
from geraf2.errors import UserError
from geraf2.io.regular import TEXT_BYTES, read_regular
from geraf2.io.text import parse_json, read_text

# Values that a log rounds to the steps of the chip: 0.048 MHz/us of slope, 54 Hz, 10 ns.
_CLOSE = {"chirp_slope_hz_per_s": 1e-2, "adc_start_s": 1e-2}


# Values of a chirp in the order of `ti.profile_values`, and what follows their names in JSON.
_PROFILE = {
    "startFreqConst": "_GHz",
    "adcStartTimeConst": "_usec",
    "freqSlopeConst": "_MHz_usec",
    "numAdcSamples": "",
    "digOutSampleRate": "",
}
_XML_MARK = "apiname_profile_cfg"
_LOW_POWER = "is of a low-power chip (xWRL1432, xWRL6432)"


def read_ti_configs(paths: Iterable[Path]) -> ti.TiConfig:
    """Read configuration files of one recording; a value given twice must be the same."""
    known: dict[str, Any] = {}
    source_of: dict[str, Path] = {}
    for path in paths:
        for name, value in vars(_read_one(path)).items():
            if value is None:
                continue
            before, close = known.setdefault(name, value), _CLOSE.get(name, 1e-6)
            source = source_of.setdefault(name, path)
            same = before == value or (
                isinstance(value, (int, float)) and math.isclose(before, value, rel_tol=close)
            )
            if not same:
                what = f"contradicts {source} on {name}"
                raise UserError(what=what, where=path, expected=before, got=value)
    return ti.TiConfig(**known)


def find_ti_configs(source: Path) -> list[Path]:
    """All configuration files in the folder of a recording, or the log of a single file."""
    if source.is_file():
        stem = re.sub(r"_Raw_\d+$", "", source.stem, flags=re.IGNORECASE)
        found = [source.with_name(f"{stem}_LogFile.txt")]
    else:
        patterns = ("*.mmwave.json", "*cf.json", "*.cfg", "*.xml", "*logfile.txt")
        # Logs come last, since their values are rounded; the first value is used.
        names = sorted(source.iterdir())
        found = [path for end in patterns for path in names if fnmatch(path.name.lower(), end)]
    # Logs of sessions without a profile are ignored, and other XML.
    needed = {".txt": b"ProfileConfig", ".xml": _XML_MARK.encode()}
    return [
        path
        for path in found
        if path.is_file()
        and (mark := needed.get(path.suffix.lower(), b""))
        in (read_regular(path, TEXT_BYTES) if mark else b"")
    ]


def _read_one(path: Path) -> ti.TiConfig:
    text = read_text(path)
    if path.suffix.lower() == ".cfg":
        return _from_profile(text, path)
    if _XML_MARK in text:
        return _from_xml(text, path)
    if has_calls(text) or path.suffix.lower() in (".txt", ".lua"):
        return read_log(text, path)
    values: Any = None
    if text.lstrip()[:1] in ("{", "["):
        try:
            values = parse_json(text)
        except ValueError as error:
            raise UserError(what=f"is not valid JSON: {error}", where=path) from None
    values = values if isinstance(values, dict) else {}
    if "mmWaveDevices" in values:
        return _from_studio(values, path)
    if "configUsed" in values:  # its DCA1000Config is no profile
        meant = re.split(r"[\\/]", str(values["configUsed"]))[-1] or "the *.mmwave.json"
        raise UserError(
            what="is the setup of a recording, without the radar's parameters",
            where=path,
            expected=f"{meant}, which it names",
            hint=f"give --config {meant}",
        )
    if "DCA1000Config" in values:
        return _from_capture_card(values, path)
    raise UserError(
        what="is no configuration of a TI radar",
        where=path,
        expected="mmWaveDevices or settings in XML (mmWave Studio), DCA1000Config, a .cfg profile, "
        "LogFile.txt, or a script with its calls",
    )


def _value_at(values: Any, keys: str, path: Path) -> Any:
    """Value at dotted keys of a JSON object; UserError names the first one that is missing."""
    for key in keys.split("."):
        if not isinstance(values, Mapping) or key not in values:
            raise UserError(what=f"key {key!r} of {keys} is missing", where=path)
        values = values[key]
    return values


def _number(values: Any, keys: str, path: Path) -> float:
    return ti.to_number(_value_at(values, keys, path), keys, path)


def _optional(values: Any, keys: str, path: Path) -> float | None:
    """Return a number, or None where any of its keys is missing."""
    for key in keys.split("."):
        values = values.get(key) if isinstance(values, Mapping) else None
    return None if values is None else ti.to_number(values, keys, path)


def _tables(values: Any, keys: str, inner: str, path: Path) -> list[Any]:
    """Objects `inner` of a list; entries without it are skipped."""
    entries = _value_at(values, keys, path)
    if not isinstance(entries, list):
        raise UserError(what=f"key {keys!r} is no list", where=path)
    return [entry[inner] for entry in entries if isinstance(entry, Mapping) and inner in entry]


def _span(chirps: Any, path: Path) -> tuple[int, int]:
    """First and last chirp."""
    return int(_number(chirps, "chirpStartIdx", path)), int(_number(chirps, "chirpEndIdx", path))


def _from_studio(values: Mapping[str, Any], path: Path) -> ti.TiConfig:
    devices = values["mmWaveDevices"]
    if not isinstance(devices, list) or len(devices) != 1:
        got = len(devices) if isinstance(devices, list) else type(devices).__name__
        raise UserError(what="must describe one radar device", where=path, got=got)
    rf, raw = _value_at(devices[0], "rfConfig", path), "rawDataCaptureConfig"
    profiles = _tables(rf, "rlProfiles", "rlProfileCfg_t", path)
    if not profiles:
        raise UserError(what="has no rlProfileCfg_t", where=path)
    chirps = _tables(rf, "rlChirps", "rlChirpCfg_t", path)
    used = {_optional(chirp, "profileId", path) for chirp in chirps} - {None}
    if len(used) > 1:
        what = f"chirps of {len(used)} profiles alternate"
        raise UserError(what=what, where=path, expected="one profile")
    own = [one for one in profiles if _optional(one, "profileId", path) in used]
    profile = (own or profiles)[0]
    table = [(*_span(c, path), int(_number(c, "txEnable", path))) for c in chirps]
    first, last = _span(_value_at(rf, "rlFrameCfg_t", path), path)
    codes = _tables(rf, "rlBpmChirps", "rlBpmChirpCfg_t", path) if "rlBpmChirps" in rf else ()
    turned = [(*_span(c, path), ti.bpm_mask(_number(c, "constBpmVal", path))) for c in codes]
    lanes = _optional(devices[0], f"{raw}.rlDevLaneEnable_t.laneEn", path)
    interleave = _optional(devices[0], f"{raw}.rlDevDataFmtCfg_t.chInterleave", path)
    rx_mask = _optional(rf, "rlChanCfg_t.rxChannelEn", path)
    is_real = None
    if "rlAdcOutCfg_t" in rf:
        bits, output = (
            _number(rf, f"rlAdcOutCfg_t.fmt.{key}", path) for key in ("b2AdcBits", "b2AdcOutFmt")
        )
        is_real = ti.is_real_16(bits, output, path)
    chirp = [_number(profile, f"{name}{unit}", path) for name, unit in _PROFILE.items()]
    return ti.TiConfig(
        **ti.profile_values(chirp),
        n_rx=None if rx_mask is None else int(rx_mask).bit_count(),
        transmitters=ti.transmitters_of(table, first, last, path, turned) if table else None,
        n_chirps_per_frame=(last - first + 1) * int(_number(rf, "rlFrameCfg_t.numLoops", path)),
        n_frames=int(_number(rf, "rlFrameCfg_t.numFrames", path)) or None,
        frame_period_s=1e-3 * _number(rf, "rlFrameCfg_t.framePeriodicity_msec", path),
        n_lanes=None if lanes is None else int(lanes).bit_count(),
        is_real=is_real,
        interleaved=None if interleave is None else interleave == 0,
    )


def _from_capture_card(values: Any, path: Path) -> ti.TiConfig:
    bits = {1: 12, 2: 14, 3: 16}.get(int(_number(values, "DCA1000Config.dataFormatMode", path)))
    if bits != 16:
        raise UserError(what="samples are not of 16 bits", where=path, expected=16, got=bits)
    lanes = {1: 4, 2: 2}.get(int(_number(values, "DCA1000Config.lvdsMode", path)))
    if lanes is None:
        expected = "1 (4 lanes) or 2 (2 lanes)"
        raise UserError(what="lvdsMode is not known", where=path, expected=expected)
    return ti.TiConfig(n_lanes=lanes)


def _from_xml(text: str, path: Path) -> ti.TiConfig:
    """Read settings of mmWave Studio: sections of parameters, units as in its windows."""
    # It saves a single one of several chirps, so that the transmitters of a loop may be unknown.
    try:
        # Entities unpack to any size.
        has_entities = "<!" in re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
        root = ET.fromstring("" if has_entities else text)
    except ET.ParseError as error:
        what = "declares entities" if has_entities else f"is not valid XML: {error}"
        raise UserError(what=what, where=path) from None
    values = {
        f"{section.tag.removeprefix('apiname_').removesuffix('_cfg')}.{one.get('name')}": (
            one.get("value", "").strip().replace(",", ".")
        )
        for section in root
        for one in section
    }

    def number(name: str) -> float:
        if name not in values:
            raise UserError(what=f"parameter {name!r} is missing", where=path)
        return ti.to_number(values[name], name, path)

    def mask(name: str, first: int, n: int) -> int | None:
        """Bits whose names end with numbers from `first` on; None where there is none."""
        named = [name.format(first + k) for k in range(n)]
        bits = [bool(number(one)) if one in values else None for one in named]
        return None if set(bits) == {None} else sum(1 << k for k, bit in enumerate(bits) if bit)

    first, last = (int(number(f"frame.fchirp{end}Idx")) for end in ("Start", "End"))
    start, stop = (int(number(f"chirp.chirp{end}Idx")) for end in ("Start", "End"))
    tx_mask = mask("chirp.tx{}Enable", 0 if "chirp.tx0Enable" in values else 1, 3)
    rx_mask, lanes = mask("channel.rx{}En", 0, 4), mask("lvdslane.lane{}En", 1, 4)
    is_known = tx_mask is not None and start <= first and stop >= last
    profile = [number(f"profile.{name}") for name in _PROFILE]
    return ti.TiConfig(
        **ti.profile_values(profile),
        n_rx=None if rx_mask is None else int(rx_mask).bit_count(),
        transmitters=ti.transmitters_of([(start, stop, tx_mask)], first, last, path)
        if is_known and tx_mask is not None
        else None,
        n_chirps_per_loop=last - first + 1,
        n_chirps_per_frame=(last - first + 1) * int(number("frame.loopCount")),
        n_frames=int(number("frame.frameCount")) or None,
        frame_period_s=1e-3 * number("frame.periodicity"),
        n_lanes=lanes.bit_count() if lanes else None,
        is_real=ti.is_real_16(number("adc.bitsVal"), number("adc.formatVal"), path),
    )


_COMPENSATION = "compRangeBiasAndRxChanPhase"
# Least and largest number of values in a line of a profile. A frameCfg of the AWR2944 has eight,
# with the number of samples before the period.
_LINE_LENGTHS = {
    "profileCfg": (11, 14),
    "frameCfg": (5, 8),
    "chirpCfg": (8, 8),
    "channelCfg": (2, 5),
    "adcCfg": (2, 2),
    "bpmCfg": (4, 4),
    "lvdsStreamCfg": (4, 4),
    _COMPENSATION: (3, 2 * 64 * 64 + 1),
}
# Lines of what is not read.
_UNREAD_LINES = {
    "advFrameCfg": "describes frames of several sub-frames",
    "subFrameCfg": "describes frames of several sub-frames",
    "chirpComnCfg": _LOW_POWER,
    "chirpTimingCfg": _LOW_POWER,
}


def _from_profile(text: str, path: Path) -> ti.TiConfig:
    lines: dict[str, list[list[float]]] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        name, *words = line.split("%", 1)[0].split() or [""]
        if name in _UNREAD_LINES:
            raise UserError(
                what=f"line {number}: {name}: the profile {_UNREAD_LINES[name]}",
                where=path,
                expected="one profileCfg, chirpCfg and frameCfg",
                hint=ti.GIVE,
            )
        if name not in _LINE_LENGTHS:
            continue
        least, most = _LINE_LENGTHS[name]
        values = [ti.to_number(word, f"line {number}, {name}", path) for word in words]
        ti.require_count(f"line {number}: {name}", len(values), least, most, path)
        lines.setdefault(name, []).append(values)
    profiles = lines.get("profileCfg", [])
    if len(profiles) != 1:
        raise UserError(what="must have one line profileCfg", where=path, got=len(profiles))
    (profile,) = profiles
    frame = lines.get("frameCfg", [[]])[-1]
    if len(frame) == 8 and frame.pop(4) != profile[9]:
        raise UserError(
            what="frameCfg has eight values, of which the fifth is no number of samples",
            where=path,
            expected=f"{profile[9]:g}, as in profileCfg",
            hint=ti.GIVE,
        )
    channel, adc = (lines.get(name, [[]])[-1] for name in ("channelCfg", "adcCfg"))
    for _, _, data_format, _ in lines.get("lvdsStreamCfg", [])[-1:]:
        if data_format not in (0, 1):
            raise UserError(
                what="lvdsStreamCfg puts more than samples into the stream",
                where=path,
                expected="-1 0 1 0, samples alone",
                got=f"format {data_format:g}",
            )
    bias_m, gains = _compensation(lines.get(_COMPENSATION, [[0.0, 1.0, 0.0]])[-1], path)
    return ti.TiConfig(
        **ti.profile_values(profile, (1, 3, 7, 9, 10)),
        path_bias_m=2.0 * bias_m or None,
        channel_gains=gains,
        n_rx=int(channel[0]).bit_count() if channel else None,
        is_real=ti.is_real_16(adc[0], adc[1], path) if adc else None,
        transmitters=_transmitters(lines, frame, path) if frame else None,
        n_chirps_per_frame=int(frame[1] - frame[0] + 1) * int(frame[2]) if frame else None,
        n_frames=(int(frame[3]) or None) if frame else None,
        frame_period_s=1e-3 * frame[4] if frame else None,
    )


def _compensation(values: list[float], path: Path) -> tuple[float, tuple[complex, ...] | None]:
    """Range bias [m], and the factor of each channel, receivers fastest; None where all are 1."""
    bias_m, *parts = values
    if len(parts) % 2:
        what = f"{_COMPENSATION} must have a range bias and pairs of numbers"
        raise UserError(what=what, where=path, got=f"{len(values)} numbers")
    gains = tuple(complex(a, b) for a, b in zip(parts[::2], parts[1::2], strict=True))
    return bias_m, None if set(gains) == {1} else gains


def _transmitters(
    lines: Mapping[str, list[list[float]]], frame: list[float], path: Path
) -> ti.Transmitters | None:
    chirps = [(int(c[0]), int(c[1]), int(c[7])) for c in lines.get("chirpCfg", [])]
    # 'bpmCfg subframe enabled chirp0 chirp1': the second transmitter of chirp1 is turned.
    turned = []
    for _, enabled, _, chirp in lines.get("bpmCfg", [])[-1:]:
        mask = next((m for a, b, m in chirps if a <= int(chirp) <= b), 0) if enabled else 0
        if mask.bit_count() > 1:
            turned.append((int(chirp), int(chirp), 1 << mask.bit_length() - 1))
    return ti.transmitters_of(chirps, int(frame[0]), int(frame[1]), path, turned)
