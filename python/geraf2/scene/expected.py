"""What a scan may be expected to reach, from what it sees: a fit to `geraf2 benchmark`'s scan_time."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Expected:
    """Figures that the default preset reaches in the mean."""

    f1_5mm: float
    f1_15mm: float
    error_m: float
    """Median distance of surface and truth, both ways [m]."""


def expected_of(seen_share: float, n_planes: int, spacing_m: float) -> Expected:
    """Figures of a scan.

    seen_share: of all normals, in which a surface is seen.
    """
    f1 = 1.0 - 0.2 * (1 - seen_share)
    return Expected(f1_5mm=f1, f1_15mm=1.0, error_m=0.001)
