"""Transmitters of the chirps of a frame, from their channel masks and phase codes.

Transmitters that take turns have a chirp each. Transmitters that send together are separated by
their signs: of two, the second is turned by 180 degrees in every other chirp (BPM), so that
A = (c0 + c1) / 2 and B = (c0 - c1) / 2. In general a loop of chirps is the code matrix times the
signals of the transmitters, and its inverse separates them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from geraf2._types import Floats
from geraf2.errors import UserError

# Least singular value over the largest: below it noise is amplified more than ten times.
_LEAST_SINGULAR = 0.1

Chirps = Sequence[tuple[int, int, int]]
"""First and last index of chirps, and the mask of their transmitters or of those turned."""


@dataclass(frozen=True)
class Transmitters:
    """Masks of the chirps of a loop, bit k for transmitter k, and the masks of turned ones."""

    masks: tuple[int, ...]
    turned: tuple[int, ...]

    @property
    def n_chirps(self) -> int:
        """Chirps of a loop."""
        return len(self.masks)

    @property
    def take_turns(self) -> bool:
        """Whether each chirp has a single transmitter."""
        return all(mask.bit_count() == 1 for mask in self.masks)

    @property
    def together(self) -> tuple[int, ...]:
        """Transmitters in the order of their first chirp, the lowest of a chirp first."""
        bits = [k for mask in self.masks for k in range(mask.bit_length()) if mask >> k & 1]
        return tuple(dict.fromkeys(bits))

    @cached_property
    def decoder(self) -> Floats | None:
        """Matrix that separates transmitters that send together; None where none does.

        (n_tx, n_chirps), rows in the order of `together`.
        """
        code = np.array(
            [
                [(mask >> k & 1) * (1 - 2 * (turned >> k & 1)) for k in self.together]
                for mask, turned in zip(self.masks, self.turned, strict=True)
            ],
            dtype=np.float64,
        )
        if code.ndim != 2 or code.shape[0] != code.shape[1]:
            return None
        singular = np.linalg.svd(code, compute_uv=False)
        if singular[-1] < _LEAST_SINGULAR * singular[0]:
            return None
        return np.asarray(np.linalg.inv(code), dtype=np.float64)

    def __str__(self) -> str:
        text = f"mask{'s' * (self.n_chirps > 1)} {', '.join(map(str, self.masks))}"
        if self.take_turns:
            return f"{text}, chirp by chirp"
        if self.decoder is None:
            return f"{text}: several send together, and no code separates them"
        order = ", ".join(map(str, self.together))
        return f"{text}: several send together, separated by their signs, in the order {order}"


def transmitters_of(
    chirps: Chirps, first: int, last: int, path: Path, turned: Chirps = ()
) -> Transmitters | None:
    """Transmitters of the chirps of a frame, over the shortest period; None where not all known."""
    if last < first:
        raise UserError(what="chirpEndIdx of the frame lies before chirpStartIdx", where=path)
    pairs = [(_mask_of(chirps, k), _mask_of(turned, k) or 0) for k in range(first, last + 1)]
    masks = [mask for mask, _ in pairs if mask is not None]
    if len(masks) < len(pairs):
        return None
    if not all(masks):
        raise UserError(
            what=f"chirp {first + masks.index(0)} has no transmitter",
            where=path,
            expected="a mask of one or more",
        )
    n = len(pairs)
    period = next(p for p in range(1, n + 1) if n % p == 0 and pairs == pairs[:p] * (n // p))
    return Transmitters(tuple(masks[:period]), tuple(code for _, code in pairs[:period]))


def _mask_of(chirps: Chirps, index: int) -> int | None:
    return next((mask for start, end, mask in chirps if start <= index <= end), None)
