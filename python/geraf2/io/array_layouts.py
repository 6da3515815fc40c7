"""Arrays of an .npz file whose types, shapes and contents are known beforehand."""

from collections.abc import Mapping

import numpy as np

from geraf2._types import AnyPath, Array
from geraf2.errors import UserError
from geraf2.io.arrays import read_npz

_KINDS = {"float": "f", "complex": "c", "int": "iu", "index": "iu", "bool": "b", "text": "U"}
_LARGEST = 1e12
"""Magnitude of a number; squares and cubes of all below are finite."""


def read_arrays(path: AnyPath, layouts: Mapping[str, str]) -> dict[str, Array]:
    """Arrays by name; UserError where one is not as its layout states.

    layouts: of each array its kind (float, complex, int, bool, text) and the length of each axis: a
    number, or a letter, which stands for one length in all arrays, as in "float n 3". Numbers are
    finite. The kind "index:n" is an integer from 0 to n - 1. An array of a kind that ends in "?"
    may be empty.
    """
    arrays, lengths = read_npz(path, layouts), dict[str, int]()
    for name, layout in layouts.items():
        kind, *axes = layout.split()
        array, wrong = arrays[name], ""
        if kind.endswith("?") and not array.size:
            continue
        for length, axis in zip(array.shape, axes, strict=False):
            lengths.setdefault(axis, int(axis) if axis.isdecimal() else length)
        expected = tuple(lengths.get(axis, 0) for axis in axes)
        kind, _, bound = kind.rstrip("?").partition(":")
        if array.dtype.kind not in _KINDS[kind]:
            wrong = f"type {array.dtype}"
        elif array.shape != expected:
            wrong = f"shape {array.shape}"
        elif kind in ("float", "complex", "int") and not (
            float(np.abs(array).max(initial=0)) <= _LARGEST
        ):
            wrong = "numbers that are not finite, or huge"
        elif bound and array.size and not (array.min() >= 0 and array.max() < lengths[bound]):
            wrong = f"indices {array.min()} to {array.max()}"
        if wrong:
            raise UserError(
                what=f"the array {name} is not what geraf2 writes",
                where=path,
                expected=f"{kind}, {expected}",
                got=wrong,
                hint="run again what made the file",
            )
    return arrays
