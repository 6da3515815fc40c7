"""What a scan may be expected to reach, from what it sees."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Expected:
    """Figures that the default preset reaches in the mean."""

    f1_5mm: float
    f1_15mm: float
    error_m: float
    """Median distance of surface and truth, both ways [m]."""


def expected_of(hidden_rad: float, spacing_m: float) -> Expected:
    """Figures of a scan.

    hidden_rad: mean over all normals of the angle to the nearest that is seen.
    """
    f1 = 1.0 - 0.13 * hidden_rad - 1.0 * spacing_m
    return Expected(f1_5mm=f1, f1_15mm=1.0, error_m=0.001 * (1 + hidden_rad))
