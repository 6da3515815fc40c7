"""What a scan may be expected to reach, from what it leaves hidden."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Expected:
    """Means of what the preset `fast` reaches on figures of the benchmark, and how they spread."""

    f1_5mm: float
    f1_15mm: float
    error_m: float
    """Median distance of surface and truth, both ways [m]."""
    spread_5mm: float
    """Standard deviation of F1 at 5 mm over the figures."""

    def __str__(self) -> str:
        return (
            f"F1 {self.f1_5mm:.2f} +- {self.spread_5mm:.2f} at 5 mm, {self.f1_15mm:.2f} at 15 mm, "
            f"median error {1e3 * self.error_m:.1f} mm"
        )


def expected_of(hidden_rad: float) -> Expected:
    """Figures of a scan."""
    return Expected(
        f1_5mm=max(0.0, 1.0 - 0.13 * hidden_rad),
        f1_15mm=1.0,
        error_m=0.001 * (1 + hidden_rad),
        spread_5mm=0.02,
    )
