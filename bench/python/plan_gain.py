"""What the planes that `geraf2 plan` chooses gain over one ring in the same minutes.

    python bench/python/plan_gain.py OUT [--minutes 2 --channels 8] [--seeds 1000:1008]

Each seed names an ordinary object in its carton (docs/benchmark.md), of which a scan as planned and
a ring of as many planes are simulated and reconstructed. Prints both tables and paired differences,
with the standard error of F1 at 5 mm. Without --minutes, the plan is the one of no flag.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from geraf2.apps.benchmark.population import (
    SETS,
    Population,
    SceneSet,
    parse_seeds,
    records_of,
)
from geraf2.apps.benchmark.population_table import paired_table, preset_table
from geraf2.apps.benchmark.runner import Runner
from geraf2.apps.planning.planning import PlanOptions, make_timed_plan
from geraf2.simulation.population import DrawnScene
from geraf2.simulation.spec import RingSpec, ScanSpec


def planned_scene(options: argparse.Namespace, *, one_ring: bool) -> Callable[[int], DrawnScene]:
    """Draw the ordinary scene of a seed, scanned as planned or by one ring."""

    def draw(seed: int) -> DrawnScene:
        drawn = SETS["ordinary"].draw(seed)
        wanted = PlanOptions(
            box=drawn.spec.walls[0].size_m, minutes=options.minutes, channels=options.channels
        )
        plan = make_timed_plan(wanted)
        design, rings = plan.design, []
        if design.n_raised and not one_ring:
            start_deg = 180.0 / design.n_raised
            rings.append(
                RingSpec(
                    n_poses=design.n_raised,
                    elevation_deg=design.raised_deg,
                    start_angle_deg=start_deg,
                )
            )
        if design.above and not one_ring:
            rings.append(RingSpec(elevation_deg=90.0))
        scan = ScanSpec(
            n_poses=design.n_planes if one_ring else design.n_around,
            aperture_m=design.aperture_m,
            spacing_m=design.spacing_m,
            standoff_m=float(np.linalg.norm(plan.planes[0].middle_m)),
            rings=tuple(rings),
        )
        record = {**drawn.record, "scan": "one ring" if one_ring else "raised planes"}
        record |= {"plan": str(design), "seen": plan.seen_share, "ring_seen": plan.ring_share}
        return DrawnScene(spec=replace(drawn.spec, scan=scan), record=record)

    return draw


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--channels", type=int, default=8)
    parser.add_argument("--seeds", default="1000:1008")
    parser.add_argument("--preset", default="fast")
    options = parser.parse_args()
    minutes = "default" if options.minutes is None else f"{options.minutes:g}"
    results = []
    for one_ring in (True, False):
        scenes = SceneSet(
            name=f"{'ring' if one_ring else 'plan'}-{options.channels}-{minutes}",
            version=SETS["ordinary"].version,
            draw=planned_scene(options, one_ring=one_ring),
            example="",
        )
        runner = Runner(out=options.out, num_threads=1)
        task = Population(runner=runner, presets=(options.preset,), scenes=scenes)
        results.append(task.run(parse_seeds(options.seeds), lambda row, r: print(row.name, r)))
        print("\n".join(preset_table(scenes.name, results[-1], records_of(options.out, scenes))))
    print("\n".join(paired_table("as planned less one ring", *results)))
    gain = np.array([b.score("f1_5mm") - a.score("f1_5mm") for a, b in zip(*results, strict=True)])
    error = gain.std(ddof=1) / np.sqrt(len(gain))
    print(f"F1 at 5 mm, as planned less one ring: {gain.mean():+.3f} +- {error:.3f}")


if __name__ == "__main__":
    main()
