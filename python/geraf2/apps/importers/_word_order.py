"""Orders of the 16-bit words in a raw capture of a TI board, and their decoding."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from geraf2.io.samples import complex_samples

Layout = Literal["4-lane", "2-lane-pairs", "2-lane-sequential", "iq"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)
# Words decoded at a time: with their copies they fit into the second-level cache, and threads
# seldom wait for the interpreter.
_DECODE_WORDS = 1 << 18
SIGN_BIT = np.int16(-0x8000)


@dataclass(frozen=True, kw_only=True)
class WordOrder:
    """Order of the 16-bit words of complex samples."""

    layout: Layout
    n_rx: int
    offset_binary: bool = False
    swap_iq: bool = False

    def __post_init__(self) -> None:
        if self.layout == "2-lane-pairs" and self.n_rx % 2:
            msg = f"2-lane-pairs needs an even n_rx, got {self.n_rx}"
            raise ValueError(msg)

    def __str__(self) -> str:
        return (
            f"{self.layout}, {'offset binary' if self.offset_binary else 'two-complement'}"
            f"{', I and Q swapped' if self.swap_iq else ''}"
        )


def decode(words: NDArray[np.int16], order: WordOrder, n_samples: int) -> NDArray[np.complex64]:
    """Complex samples of whole chirps, (n_chirps, n_rx, n_samples); see `decode_integers`."""
    return complex_samples(decode_integers(words, order, n_samples))


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
