"""Orders of the 16-bit words in a raw capture of a TI board, and their decoding."""

from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray
from scipy.fft import ifft, rfft

from geraf2.io.manifest import ComplexLayout, RealLayout
from geraf2.io.samples import complex_samples

Layout = ComplexLayout | RealLayout
LAYOUTS: tuple[ComplexLayout, ...] = get_args(ComplexLayout)
REAL_LAYOUTS: tuple[RealLayout, ...] = get_args(RealLayout)
# Words decoded at a time: with their copies they fit into the second-level cache, and threads
# seldom wait for the interpreter.
_DECODE_WORDS = 1 << 18
SIGN_BIT = np.int16(-0x8000)


@dataclass(frozen=True, kw_only=True)
class WordOrder:
    """Order of the 16-bit words of complex or real samples."""

    layout: Layout
    n_rx: int
    offset_binary: bool = False
    swap_iq: bool = False

    def __post_init__(self) -> None:
        if self.layout == "2-lane-pairs" and self.n_rx % 2:
            msg = f"2-lane-pairs needs an even n_rx, got {self.n_rx}"
            raise ValueError(msg)

    @property
    def is_real(self) -> bool:
        """Whether each word is a sample; two of them make a complex one."""
        return self.layout in REAL_LAYOUTS

    @property
    def is_sequential(self) -> bool:
        """Whether receivers follow each other chirp by chirp."""
        return self.layout in ("2-lane-sequential", "real-sequential")

    @property
    def n_alternating(self) -> int:
        """Receivers that alternate from sample to sample."""
        return 1 if self.is_sequential else self.n_rx

    @property
    def per_complex(self) -> int:
        """Samples of a receiver in the file that make a complex one."""
        return 2 if self.is_real else 1

    def __str__(self) -> str:
        return (
            f"{self.layout}, {'offset binary' if self.offset_binary else 'two-complement'}"
            f"{', I and Q swapped' if self.swap_iq else ''}"
        )


def decode(words: NDArray[np.int16], order: WordOrder, n_samples: int) -> NDArray[np.complex64]:
    """Complex samples of whole chirps, (n_chirps, n_rx, n_samples); see `decode_integers`."""
    if order.is_real:
        return analytic(real_words(words, order, 2 * n_samples))
    return complex_samples(decode_integers(words, order, n_samples))


def real_words(words: NDArray[np.int16], order: WordOrder, n_samples: int) -> NDArray[np.float32]:
    """Real samples of whole chirps, (n_chirps, n_rx, n_samples)."""
    signed = words ^ SIGN_BIT if order.offset_binary else words
    n_chirps = words.size // (order.n_rx * n_samples)
    signed = signed[: n_chirps * order.n_rx * n_samples]
    if order.layout == "real-sequential":
        return signed.reshape(n_chirps, order.n_rx, n_samples).astype(np.float32)
    chirps = signed.reshape(n_chirps, n_samples, order.n_rx).transpose(0, 2, 1)
    return np.ascontiguousarray(chirps, dtype=np.float32)


def analytic(samples: NDArray[np.float32]) -> NDArray[np.complex64]:
    """Every other sample of the analytic signal, (..., n) -> (..., n / 2).

    It has no negative frequencies, so half the sample rate holds all of it: an echo
    A cos(2 pi f t) becomes A exp(2 pi i f t).
    """
    half = samples.shape[-1] // 2
    spectrum = rfft(samples, axis=-1)
    spectrum[..., 0] = 0.5 * (spectrum[..., 0] + spectrum[..., half])
    return np.asarray(ifft(spectrum[..., :half], axis=-1), dtype=np.complex64)


def decode_integers(
    words: NDArray[np.int16], order: WordOrder, n_samples: int
) -> NDArray[np.int16]:
    """I and Q of whole chirps, (n_chirps, n_rx, n_samples, 2).

    words: (n_chirps * n_samples * n_rx * 2,) as stored in the file.
    order: their order.
    n_samples: samples per chirp.
    """
    chirp = 2 * order.n_rx * n_samples
    n_chirps = words.size // chirp
    signal = np.empty((n_chirps, order.n_rx, n_samples, 2), dtype=np.int16)
    flat = signal.reshape(-1)
    step = max(1, _DECODE_WORDS // chirp)
    for first in range(0, n_chirps, step):
        chosen = slice(first * chirp, min(first + step, n_chirps) * chirp)
        some = flat[chosen]
        _pack(words[chosen], some, order, n_samples)
        if order.offset_binary:
            some ^= SIGN_BIT
    return signal


def _pack(
    words: NDArray[np.int16], packed: NDArray[np.int16], order: WordOrder, n_samples: int
) -> None:
    """Copy words into the order (n_chirps, n_rx, n_samples, I and Q).

    Each part of each receiver is one strided copy: a single NumPy call, whose inner loop is the
    short axis, takes 2 to 4 times as long (bench/python/import_raw.py).
    """
    n_rx = order.n_rx
    if order.layout == "iq" and not order.swap_iq:  # I and Q of a sample move together
        pairs = words.view(np.uint32).reshape(-1, n_samples, n_rx)
        packed.view(np.uint32).reshape(-1, n_rx, n_samples)[...] = pairs.transpose(0, 2, 1)
        return
    lanes: list[tuple[NDArray[np.int16], NDArray[np.int16]]]
    target: NDArray[np.int16]
    if order.layout == "2-lane-sequential":  # I(n) I(n+1) Q(n) Q(n+1), receiver after receiver
        target = packed.reshape(-1, 2, 2)
        quads = words.reshape(-1, 2, 2)
        lanes = [(quads[:, 0, side], quads[:, 1, side]) for side in range(2)]
    else:
        target = packed.reshape(-1, n_rx, n_samples, 2).transpose(0, 2, 1, 3)
        n_chirps = words.size // (2 * n_rx * n_samples)
        # Groups of receivers, I and Q, receivers of a group.
        if order.layout == "4-lane":  # I0 I1 I2 I3 Q0 Q1 Q2 Q3
            both = words.reshape(n_chirps, n_samples, 1, 2, n_rx)
        elif order.layout == "iq":  # I0 Q0 I1 Q1 ...
            both = words.reshape(n_chirps, n_samples, n_rx, 2, 1)
        else:  # I0 I1 Q0 Q1 I2 I3 Q2 Q3
            both = words.reshape(n_chirps, n_samples, n_rx // 2, 2, 2)
        lanes = [
            (both[:, :, group, 0, side], both[:, :, group, 1, side])
            for group, side in np.ndindex(both.shape[2], both.shape[4])
        ]
    for lane, (in_phase, quadrature) in enumerate(lanes):
        target[..., lane, int(order.swap_iq)] = in_phase
        target[..., lane, 1 - int(order.swap_iq)] = quadrature
