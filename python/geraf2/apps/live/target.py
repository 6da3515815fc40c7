"""Targets of a scan: how good its surface must be stated to be."""

import re
from dataclasses import dataclass

from geraf2.errors import UserError
from geraf2.pipeline.reconstruction import Reconstruction
from geraf2.surfaces.expected_error import typical_error_m
from geraf2.surfaces.stated_score import stated_f1

SURE = 0.9
"""Least probability of a score at which it counts as reached."""
_NUMBER = r"(\d+(?:\.\d+)?|\.\d+)"
_EXPECTED = re.compile(rf"expected {_NUMBER} mm over {_NUMBER} ?%")
_SCORE = re.compile(rf"F1 5 mm {_NUMBER}")
_FORMS = "'expected 1 mm over 90 %' or 'F1 5 mm 0.95'"


@dataclass(frozen=True, kw_only=True)
class Target:
    """An expected error that is to be kept on a share of the area, or a score."""

    error_m: float | None = None
    """Largest expected error [m]; None: a score is wanted."""
    share: float
    """Least share of the area, or least F1 at 5 mm, 0 to 1."""

    @classmethod
    def of(cls, text: "Target | str") -> "Target":
        """Target of a text; UserError for another one."""
        if isinstance(text, Target):
            return text
        line = " ".join(text.split())
        if found := _SCORE.fullmatch(line):
            target = cls(share=float(found[1]))
        elif found := _EXPECTED.fullmatch(line):
            target = cls(error_m=1e-3 * float(found[1]), share=0.01 * float(found[2]))
        else:
            raise UserError(what="is no target of a scan", expected=_FORMS, got=repr(text))
        if not 0.0 < target.share <= 1.0 or target.error_m == 0.0:
            expected = "a positive error, and a share above 0 and at most 1, or 100 %"
            raise UserError(what="is no target of a scan", expected=expected, got=repr(text))
        return target

    def is_met(self, result: Reconstruction) -> bool:
        """Whether the surface is stated to be as good."""
        mesh = result.content_mesh
        if self.error_m is None:
            return stated_f1(mesh).odds(self.share) >= SURE
        return typical_error_m(mesh, self.share) <= self.error_m
