"""What the arrays of a belt see, for `geraf2 plan --belt`."""

from dataclasses import asdict
from pathlib import Path

from geraf2.apps.belt.coverage import Coverage, coverage
from geraf2.apps.belt.monostatic import list_wide_baselines
from geraf2.apps.belt.motion import pairs_on_a_line
from geraf2.cli._console import keep, rows, warn
from geraf2.errors import UserError
from geraf2.simulation import load_spec
from geraf2.simulation.belt import belt_record


def show_belt(path: Path, box_m: tuple[float, float, float] | None) -> int:
    """Print what each array of a spec adds; box_m: of the parcels, else the spec's [m]."""
    spec = load_spec(path)
    box_m = box_m or (spec.walls[0].size_m if spec.walls else None)
    if spec.belt is None or box_m is None:
        what = "has no [belt]" if spec.belt is None else "has no [[walls]]: give --box"
        raise UserError(what=what, where=path)
    record, found = belt_record(spec.belt), list(coverage(spec.belt, box_m))
    keep({"arrays": [asdict(one) for one in found]})
    pairs = [f"{one.name} and {other.name}" for one, other, _ in pairs_on_a_line(record)]
    sides = ", ".join(f"{name} {100 * share:.0f} %" for name, share in found[-1].by_side.items())
    rows(
        [
            ("arrays", "boards  chips  normals  never seen"),
            *((f"{'+ ' * (one is not found[0])}{one.array}", _row(one)) for one in found),
            ("each side", sides),
            ("motion", f"from {', '.join(pairs)}" if pairs else "as recorded"),
        ]
    )
    for line in list_wide_baselines(record, spec.waveform):
        warn(line)
    return 0


def _row(one: Coverage) -> str:
    share, never = round(100 * one.seen_share), ", ".join(one.never_seen) or "none"
    return f"{one.n_boards:6d}  {one.n_chips:5d}  {share:5d} %  {never}"
