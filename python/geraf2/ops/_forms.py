"""Records that the kernels of volume echoes and their torch form share."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from geraf2._types import Bools, Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class EchoForm:
    """Parameters of an amplitude besides its sample."""

    centers: Floats
    """Middles of the groups of antennas, (n_groups, 3) [m]."""
    lobe_power: float = 1.0
    """Exponent p of w_o . w_r; the tracer has one power of it, p - 1 are those of the middle."""
    two_way_power: int = 1
    """2 for T^2 alpha, 1 for T alpha."""
    references: Floats | None = None
    """Distance at which 1 / u^2 of the two-way path is one, (n_groups,) [m]; None: without
    spreading."""

    @property
    def native(self) -> tuple[Floats, Floats, float, int]:
        """The same, as the kernels read it."""
        references = np.zeros(0) if self.references is None else self.references
        return self.centers, references, float(self.lobe_power), self.two_way_power


class SamplePairs(NamedTuple):
    """Pairs of a sample and a group of antennas, part after part; a part is one draw of a group."""

    sample: Ints
    """Index among all samples, ascending within a part, (n_pairs,)."""
    offsets: Ints
    """Where each part begins, (n_groups n_looks + 1,)."""
    n_looks: int

    def group(self) -> Ints:
        """Group of each pair, (n_pairs,)."""
        return np.repeat(np.arange(len(self.offsets) - 1) // self.n_looks, np.diff(self.offsets))

    def keep(self, wanted: Bools) -> "SamplePairs":
        """Those of the pairs that are wanted, (n_pairs,)."""
        before = np.concatenate([[0], np.cumsum(wanted)])
        return SamplePairs(self.sample[wanted], before[self.offsets], self.n_looks)
