"""scene.toml of an import, from what the user gave and what the source says."""

from collections.abc import Mapping
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

# One frequency has no chirp and no range; these hold whatever a plane can see, 150 m.
OF_ONE_FREQUENCY = {"chirp_slope_hz_per_s": 1e12, "sample_rate_hz": 1e6}
_KEYS = ("start_frequency_hz", "chirp_slope_hz_per_s", "sample_rate_hz")


def scene_manifest(
    importer: str,
    source: Path,
    radar: RadarManifest,
    known: Mapping[str, float | int | None],
    *,
    provenance: Mapping[str, str] | None = None,
) -> tuple[SceneManifest, list[str]]:
    """Build the manifest, and notes on what was assumed.

    importer: name of the format.
    source: what the user named, for messages.
    radar: what the user gave; goes before `known`.
    known: waveform values by the source, with n_samples; start_frequency_hz is that of the first
        sample.
    provenance: more lines for the table of this name.
    """
    waveform = _waveform(radar, known)
    missing = [key for key in _KEYS if waveform.get(key) is None]
    if missing:
        raise UserError(
            what=f"{', '.join(missing)} not known",
            where=source,
            hint="give --radar radar.toml" + (", or --config" if importer == "dca1000" else ""),
        )
    said, notes = delay_notes(waveform)
    _require_n_samples(radar, known["n_samples"], source)
    manifest = from_table(
        {
            "waveform": waveform,
            "walls": [asdict(wall) for wall in radar.walls or ()],
            "provenance": {
                **said,
                "importer": importer,
                "source": source.resolve().name,
                **(provenance or {}),
            },
        },
        SceneManifest,
        source,
    )
    return manifest, notes


def delay_notes(waveform: dict[str, Any]) -> tuple[dict[str, str], list[str]]:
    """Say whether the instrument delay is known; 0 is put in where it is not.

    waveform: values by name, without path_bias_m or None where it is not known.

    Returns lines of the provenance, and notes.
    """
    if waveform.get("path_bias_m") is not None:
        return {DELAY_KEY: DELAY_GIVEN}, []
    waveform["path_bias_m"] = 0.0
    if waveform.get("n_samples") == 1:  # a constant phase
        return {DELAY_KEY: DELAY_WITHOUT_EFFECT}, []
    note = (
        "path_bias_m (instrument delay on the two-way path) is not known and was taken as 0 m;"
        " ranges are off by half of the true value (0.075 m for an AWR1843)"
    )
    return {DELAY_KEY: DELAY_NOT_KNOWN}, [note]


def _require_n_samples(radar: RadarManifest, found: float | None, source: Path) -> None:
    if radar.n_samples is not None and radar.n_samples != found:
        raise UserError(
            what="number of ADC samples disagrees with the parameters",
            where=source,
            expected=f"n_samples = {radar.n_samples}",
            got=found,
        )


def _waveform(radar: RadarManifest, known: Mapping[str, float | int | None]) -> dict[str, Any]:
    """Values by the source, replaced by those of the user."""
    slope = radar.chirp_slope_hz_per_s or known.get("chirp_slope_hz_per_s")
    start = radar.model_copy(update={"chirp_slope_hz_per_s": slope}).first_sample_hz()
    waveform: dict[str, Any] = {
        **(OF_ONE_FREQUENCY if known.get("n_samples") == 1 else {}),
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
