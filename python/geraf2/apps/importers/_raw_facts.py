"""Facts about a raw recording: layout, strongest echo, dead receivers."""

import numpy as np

from geraf2._types import Complexes, Words
from geraf2.apps.importers._raw_layout import MIN_RATIO, LayoutEvidence, side_energies
from geraf2.apps.importers._ti_values import TiConfig
from geraf2.apps.importers._word_order import decode
from geraf2.constants import SPEED_OF_LIGHT_M_PER_S
from geraf2.io.manifest import RadarManifest

# Bins that DC occupies behind a Hann window.
_DC_BINS = 2
# A dead receiver has 30 dB less power than the others, or equal energy on both sides of its
# spectrum where the others have not (noise). On captures of real boards receivers differ by 10 dB,
# and the worst of them reaches 8 : 1.
_DEAD_POWER, _DEAD_RATIO = 1e-3, 1.5


def first_chirps(words: Words, evidence: LayoutEvidence) -> Complexes:
    """Whole chirps at the beginning of a recording, (n_chirps, n_rx, n_samples)."""
    chirp = 2 * evidence.order.n_rx * evidence.n_samples
    whole = words[: words.size // chirp * chirp]
    return decode(whole, evidence.order, evidence.n_samples)


def dead_receivers(signal: Complexes) -> list[tuple[int, str]]:
    """Dead receivers with the reason, from chirps (n_chirps, n_rx, n_samples)."""
    n_rx = signal.shape[1]
    centred = signal - signal.mean(axis=-1, keepdims=True)
    power = (np.abs(centred) ** 2).mean(axis=(0, 2), dtype=np.float64)
    sides = np.array([side_energies(signal[:, rx]) for rx in range(n_rx)])
    high, low = sides.max(axis=1), sides.min(axis=1)
    ratios = np.divide(high, low, out=np.full(n_rx, np.inf), where=low > 0)
    dead = []
    for rx in range(n_rx):
        others = np.delete(np.arange(n_rx), rx)
        if not power[rx] > 0:
            dead.append((rx, "its samples are constant"))
        elif not others.size:
            continue
        elif power[rx] < _DEAD_POWER * (usual := np.median(power[others])):
            dead.append((rx, f"{10 * np.log10(usual / power[rx]):.0f} dB below the others"))
        elif ratios[rx] < _DEAD_RATIO and np.median(ratios[others]) > MIN_RATIO:
            dead.append((rx, f"noise, the two sides of its spectrum are {ratios[rx]:.3g} : 1"))
    return dead


def describe(
    evidence: LayoutEvidence, n_tx: int, n_chirps: int, n_frames: int
) -> list[tuple[str, str]]:
    """Facts: layout, samples per chirp, size."""
    ratio, order = evidence.energy_ratio, evidence.order
    found = "found" if evidence.n_samples_found else "given"
    other = f" ({evidence.next_layout}: {evidence.next_ratio:.3g} : 1)"
    sides = f"energy of the two sides of the spectrum {max(ratio, 1 / ratio):.4g} : 1"
    stored = order.per_complex * evidence.n_samples
    made = f", read as {evidence.n_samples} complex ones at half the rate" if order.is_real else ""
    layout = "samples are real" if order.is_real else f"{sides}{other * bool(evidence.next_layout)}"
    jumps = f"the signal jumps {evidence.jump_ratio:.3g} times as much from chirp to chirp as from"
    chirps = f"{n_frames * n_chirps} chirps x {evidence.n_samples} samples x {order.n_rx} receivers"
    frames = f"{n_frames} frames of {n_chirps // n_tx} loops x {n_tx} transmitters"
    return [
        ("layout", f"{order}: {layout}"),
        ("samples per chirp", f"{stored}{made}, {found}: {jumps} sample to sample"),
        ("recording", f"{chirps}, {frames}"),
    ]


def describe_peak(
    signal: Complexes, evidence: LayoutEvidence, radar: RadarManifest, config: TiConfig
) -> tuple[str, str]:
    """Fact: bin of the strongest echo, and its range [m] where the waveform is known."""
    n = evidence.n_samples
    centred = signal - signal.mean(axis=-1, keepdims=True)
    spectrum = np.fft.fft(centred * np.hanning(n + 1)[:n], axis=-1)
    power = (np.abs(spectrum) ** 2).mean(axis=(0, 1))
    if evidence.energy_ratio < 1:
        power = power[-np.arange(n)]
    highest = n if evidence.order.is_real else n // 2
    strongest = _DC_BINS + int(np.argmax(power[_DC_BINS:highest]))
    text = f"bin {strongest} of {n}"
    slope = radar.chirp_slope_hz_per_s or config.chirp_slope_hz_per_s
    rate = radar.sample_rate_hz or config.sample_rate_hz
    if slope and rate:
        rate /= evidence.order.per_complex
        path = strongest * SPEED_OF_LIGHT_M_PER_S * rate / (n * slope)
        text += f", {0.5 * (path - (radar.path_bias_m or config.path_bias_m or 0.0)):.3f} m"
    return "strongest echo", text
