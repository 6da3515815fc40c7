"""What a scan may be expected to reach, from the share of normals that it sees."""

from dataclasses import dataclass

# 1 - F1 at 5 mm and the median error [m] are a + b / share: least squares on means over four
# figures (bunny, elephant, deer, chicken) of six scans of 4 to 21 planes at 4 mm, by `fast`.
_F1_5MM, _ERROR_M = (0.0280, 0.0040), (1.03e-3, 0.040e-3)
# Of F1 at 15 mm the mean; of single figures at 5 mm the standard deviation about the line.
_F1_15MM, _SPREAD_5MM = 0.999, 0.026
# Below nothing was measured: four planes around see a share of 0.065.
_LEAST_SHARE = 0.03


@dataclass(frozen=True, kw_only=True)
class Expected:
    """Means of what the preset `fast` reaches on figures of the benchmark, and how they spread."""

    f1_5mm: float
    f1_15mm: float
    error_m: float
    """Median distance of surface and truth, both ways [m]."""
    spread_5mm: float = _SPREAD_5MM
    """Standard deviation of F1 at 5 mm over figures and scans."""

    def __str__(self) -> str:
        return (
            f"F1 {self.f1_5mm:.2f} +- {self.spread_5mm:.2f} at 5 mm, {self.f1_15mm:.2f} at 15 mm, "
            f"median error {1e3 * self.error_m:.1f} mm"
        )


def expected_of(seen_share: float) -> Expected:
    """Figures of a scan of free-standing figures at a spacing that leaves no ghosts.

    seen_share: of all normals, in which a surface is seen (:func:`geraf2.scene.plan.seen_share`).
    """
    inverse = 1.0 / max(seen_share, _LEAST_SHARE)
    return Expected(
        f1_5mm=1.0 - _F1_5MM[0] - _F1_5MM[1] * inverse,
        f1_15mm=_F1_15MM,
        error_m=_ERROR_M[0] + _ERROR_M[1] * inverse,
    )
