"""Detection of real samples, which a single echo may make look complex.

Words of one echo that are a quarter of its period apart pass for I and Q, with a one-sided
spectrum. An echo of a complex receiver takes one complex weight to predict, as a real one takes two
real weights; in the wrong reading it is two lines, and takes twice as many. So readings are
compared at equal numbers of weights.
"""

import numpy as np
from numpy.typing import NDArray

from geraf2.apps.importers._chirp_length import channels, prediction_error
from geraf2.apps.importers._word_order import SIGN_BIT, WordOrder
from geraf2.errors import UserError

_N_WEIGHTS = (2, 4, 8, 16)
_N_WORDS = 1 << 16
_N_ALTERNATING = (1, 2, 4)
# Words that a sample of all receivers may have: each has an offset of its own.
_OFFSET_WORDS = 16
# The lowest residuals are compared: the others lie where a chirp begins. Their mean over that of
# all, for real and complex noise.
_USED = 0.7
_MEAN_REAL, _MEAN_COMPLEX = 0.310, 0.485
# Mean logarithm of the ratio of residuals: below -1.2 on the recordings of real samples at hand,
# and above -.13 on 130 recordings of complex ones and three of real boards.
_LEAST_GAIN = -0.15


def require_complex(words: NDArray[np.int16], order: WordOrder, where: object) -> None:
    """Raise UserError where words are predicted better as real samples than in this order."""
    some = words[: min(_N_WORDS, len(words) // _OFFSET_WORDS * _OFFSET_WORDS)]
    as_complex = _residuals(channels(some, order), 0.5, _MEAN_COMPLEX)
    signed = (some ^ SIGN_BIT if order.offset_binary else some).astype(np.float32)
    signed = signed.reshape(-1, _OFFSET_WORDS)
    centred = (signed - signed.mean(axis=0)).astype(np.complex64)
    as_real = min(
        (_residuals(centred.reshape(-1, n).T, 1.0, _MEAN_REAL) for n in _N_ALTERNATING),
        key=lambda residuals: float(residuals.mean()),
    )
    if float((as_real - as_complex).mean()) < _LEAST_GAIN:
        raise UserError(
            what="the samples are real",
            where=where,
            expected="complex samples: I and Q of each receiver",
            hint="record complex ones (adcCfg 2 1), or give layout under [raw] of --radar if they "
            "are; chips that sample only real values (AWR2944, xWRL6432) are not read",
        )


def _residuals(
    streams: NDArray[np.complex64], per_weight: float, usual: float
) -> NDArray[np.float64]:
    """Logarithm of the residual over the power, for each number of real weights."""
    centred = streams - streams.mean(axis=1, keepdims=True)
    power = (np.abs(centred) ** 2).mean(axis=1, dtype=np.float64)
    alive = power > 0
    found = []
    for n_weights in _N_WEIGHTS:
        error = prediction_error(centred[alive], int(per_weight * n_weights))
        ratio = np.sort((np.abs(error).astype(np.float64) ** 2 / power[alive, None]).ravel())
        lowest = float(ratio[: max(1, int(_USED * ratio.size))].mean())
        found.append(np.log10(max(lowest / usual, 1e-12)))
    return np.array(found)
