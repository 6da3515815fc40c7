"""Numbers of other kinds than the words of 16 bits of a board, found by their values."""

import numpy as np

from geraf2._types import Words
from geraf2.apps.importers._word_order import prediction_error
from geraf2.errors import UserError

# Words whose bytes are predicted.
_N_WORDS = 1 << 17
# Samples as floating-point numbers lie between these, but for a few. Integers of 16 bits that are
# small have exponents of 16 bits below or above theirs.
_FLOATS = {"f2": (2.0**-14, 2.0**12), "f4": (2.0**-30, 2.0**30), "f8": (2.0**-30, 2.0**30)}
_FLOAT_SHARE = 0.99
# Least share of floating-point numbers of 16 bits with either sign.
_SIGN_SHARE = 0.1
# Median residual of a linear prediction of bytes, over their power, below which they are samples;
# and over that of the words, which are predicted far better where these are.
_BYTE_RESIDUAL, _BYTE_EXCESS, _BYTE_LAGS = 0.1, 2.0, 2


def require_words(words: Words, where: object) -> None:
    """Raise UserError where words are parts of floating-point or other numbers."""
    kinds = ("<f4", "<f8", ">f4", ">f8", "<f2", ">f2")
    floats = next((kind for kind in kinds if _is_float(words, kind)), None)
    if floats is not None:
        raise other_numbers(where, kind=f"floating-point numbers of {8 * int(floats[2])} bits")
    low, high = words[: words.size // 2 * 2].reshape(-1, 2).T
    if low.min() < 0 <= low.max() and (high == low >> 15).mean() > _FLOAT_SHARE:
        raise other_numbers(where, kind="integers of 32 bits")
    if _are_bytes(words):
        raise other_numbers(where, kind="integers of 8 bits")


def other_numbers(where: object, *, kind: str) -> UserError:
    """UserError for a recording of such numbers."""
    return UserError(
        what=f"holds {kind}, not words of 16 bits as a board records them",
        where=where,
        hint="write them as arrays for 'geraf2 import geraf-sens' or 'geraf2 import mat'",
    )


def _is_float(words: Words, kind: str) -> bool:
    """Whether words are parts of floating-point numbers of ordinary size."""
    # Integers of 16 bits have exponents near the least or largest one where they are small.
    data = words.tobytes()
    numbers = np.frombuffer(data[: len(data) // 8 * 8], dtype=kind)
    values, (least, largest) = np.abs(numbers), _FLOATS[kind[1:]]
    with np.errstate(invalid="ignore"):
        ordinary = (values > least) & (values < largest)
    if kind[1:] == "f2" and abs((numbers < 0).mean() - 0.5) > 0.5 - _SIGN_SHARE:
        return False
    # Round numbers of 64 bits are zeros and numbers of 32 bits in turn.
    is_half = (values[::2] == 0).mean() > 0.5
    return bool(ordinary.any() and not is_half and (ordinary | (values == 0)).mean() > _FLOAT_SHARE)


def _are_bytes(words: Words) -> bool:
    """Whether the bytes of words are samples, as predictable as the words are."""
    words = words[:_N_WORDS]
    both = words.view(np.uint8).reshape(-1, 2).T
    for flip in (0, 0x80):
        low, high = (both ^ flip).view(np.int8)
        if (high == low >> 7).mean() > 1 - _SIGN_SHARE:  # of small words
            return False
        streams = np.stack([low, high, words]).astype(np.complex64)
        power = streams.var(axis=1)
        if not power.all():
            continue
        errors = np.median(np.abs(prediction_error(streams, _BYTE_LAGS)) ** 2, axis=1)
        *of_bytes, of_words = errors / power
        if max(of_bytes) < min(_BYTE_RESIDUAL, _BYTE_EXCESS * of_words):
            return True
    return False
