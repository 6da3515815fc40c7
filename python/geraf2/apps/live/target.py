"""Target of a scan: how good its surface must be expected to be."""

import re
from dataclasses import dataclass

from geraf2.errors import UserError
from geraf2.io.verdict import Trust
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.surfaces.expected_error import typical_error_m

_NUMBER = r"(\d+(?:\.\d+)?|\.\d+)"
_FORM = re.compile(rf"expected {_NUMBER} mm over {_NUMBER} ?%")


@dataclass(frozen=True, kw_only=True)
class Target:
    """An expected error that is to be kept on a share of the area."""

    error_m: float
    """Largest expected error [m]."""
    share: float
    """Least share of the area, above 0 and at most 1."""

    @classmethod
    def of(cls, text: "Target | str") -> "Target":
        """Target of a text; UserError for another one."""
        if isinstance(text, Target):
            return text
        found = _FORM.fullmatch(" ".join(text.split()))
        if found is None:
            expected = "'expected 1 mm over 90 %'"
            raise UserError(what="is no target of a scan", expected=expected, got=repr(text))
        target = cls(error_m=1e-3 * float(found[1]), share=0.01 * float(found[2]))
        if not 0.0 < target.share <= 1.0 or target.error_m == 0.0:
            expected = "a positive error, and a share above 0 and at most 100 %"
            raise UserError(what="is no target of a scan", expected=expected, got=repr(text))
        return target

    def is_met(self, result: Reconstruction) -> bool:
        """Whether the surface is expected to be as good, and reliable if it was judged."""
        if result.verdict is not None and result.verdict.trust is not Trust.RELIABLE:
            return False
        return typical_error_m(result.content_mesh, self.share) <= self.error_m
