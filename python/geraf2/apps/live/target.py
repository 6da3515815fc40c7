"""Targets of a scan: how good its surface must be stated to be."""

import re
from dataclasses import dataclass

from geraf2.errors import UserError
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.surfaces.expected_error import typical_error_m

_NUMBER = r"(\d+(?:\.\d+)?|\.\d+)"
_EXPECTED = re.compile(rf"expected {_NUMBER} mm over {_NUMBER} ?%")


@dataclass(frozen=True, kw_only=True)
class Target:
    """An expected error that is to be kept on a share of the area."""

    error_m: float
    """Largest expected error [m]."""
    share: float
    """Least share of the area, 0 to 1."""

    @classmethod
    def of(cls, text: "Target | str") -> "Target":
        """Target of a text; UserError for another one."""
        if isinstance(text, Target):
            return text
        found = _EXPECTED.fullmatch(" ".join(text.split()))
        if found is None or not 0.0 < float(found[2]) <= 100.0 or not float(found[1]):
            raise UserError(
                what="is no target of a scan", expected="'expected 1 mm over 90 %'", got=repr(text)
            )
        return cls(error_m=1e-3 * float(found[1]), share=0.01 * float(found[2]))

    def is_met(self, result: Reconstruction) -> bool:
        """Whether the surface is stated to be as good."""
        mesh = result.content_mesh
        if mesh.expected_error_m is None:
            raise UserError(what="the preset states no expected error", expected="best or fast")
        return typical_error_m(mesh, self.share) <= self.error_m
