"""scene.toml of an import, from the parameters of the user and of the source."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from geraf2.errors import UserError
from geraf2.io.manifest import (
    DELAY_GIVEN,
    DELAY_KEY,
    DELAY_NOT_KNOWN,
    DELAY_WITHOUT_EFFECT,
    RadarManifest,
    SceneManifest,
)
from geraf2.io.toml import from_table

# Other sources of missing values, by format.
_OTHER_SOURCES = {
    **dict.fromkeys(("dca1000", "rosbag"), ", or --config"),
    "geraf-sens": ", or start_frequency_hz, chirp_slope_hz_per_s and adc_sample_rate_hz in "
    "capture.json",
}
# One frequency has no chirp and no range; these values allow ranges up to 150 m.
_OF_ONE_FREQUENCY = {"chirp_slope_hz_per_s": 1e12, "sample_rate_hz": 1e6}
_KEYS = ("start_frequency_hz", "chirp_slope_hz_per_s", "sample_rate_hz")


def scene_manifest(
    importer: str,
    source: Path,
    radar: RadarManifest,
    known: Mapping[str, float | int | None],
    *,
    provenance: Mapping[str, str] | None = None,
    walls: Sequence[Mapping[str, Any]] = (),
) -> tuple[SceneManifest, list[str]]:
    """Manifest of a scene, and notes on assumed values.

    importer: name of the format.
    source: path given by the user, for messages.
    radar: parameters given by the user; override `known`.
    known: waveform values of the source, with n_samples; start_frequency_hz is that of the first
        sample.
    provenance: further entries of the table of this name.
    walls: of the source, where the user gives none.
    """
    waveform = _waveform(radar, known)
    missing = [key for key in _KEYS if waveform.get(key) is None]
    if missing:
        raise UserError(
            what=f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} not known",
            where=source,
            hint="give --radar radar.toml" + _OTHER_SOURCES.get(importer, ""),
        )
    delay, notes = _delay_notes(waveform)
    if radar.n_samples is not None and radar.n_samples != known["n_samples"]:
        raise UserError(
            what="number of ADC samples disagrees with the parameters",
            where=source,
            expected=f"n_samples = {radar.n_samples}",
            got=known["n_samples"],
        )
    manifest = from_table(
        {
            "waveform": waveform,
            "walls": [asdict(wall) for wall in radar.walls or ()] or list(walls),
            "provenance": {
                **delay,
                "importer": importer,
                "source": source.resolve().name,
                **(provenance or {}),
            },
        },
        SceneManifest,
        source,
    )
    return manifest, notes


def _delay_notes(waveform: dict[str, Any]) -> tuple[dict[str, str], list[str]]:
    """Provenance of the instrument delay, and notes; an unknown delay is set to 0 in `waveform`."""
    if waveform.get("path_bias_m") is not None:
        return {DELAY_KEY: DELAY_GIVEN}, []
    waveform["path_bias_m"] = 0.0
    if waveform.get("n_samples") == 1:  # a constant phase
        return {DELAY_KEY: DELAY_WITHOUT_EFFECT}, []
    note = (
        "path_bias_m (instrument delay on the two-way path) is not known and was assumed to be 0 m;"
        " ranges are off by half of the true value (0.075 m for an AWR1843)"
    )
    return {DELAY_KEY: DELAY_NOT_KNOWN}, [note]


def _waveform(radar: RadarManifest, known: Mapping[str, float | int | None]) -> dict[str, Any]:
    slope = radar.chirp_slope_hz_per_s or known.get("chirp_slope_hz_per_s")
    start = radar.model_copy(update={"chirp_slope_hz_per_s": slope}).first_sample_hz()
    waveform: dict[str, Any] = {
        **(_OF_ONE_FREQUENCY if known.get("n_samples") == 1 else {}),
        **{key: value for key, value in known.items() if value is not None},
        **{
            key: value
            for key in (*_KEYS, "path_bias_m")
            if (value := getattr(radar, key)) is not None
        },
    }
    if start is not None:
        waveform["start_frequency_hz"] = start
    return waveform
