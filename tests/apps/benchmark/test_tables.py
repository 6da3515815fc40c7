"""Tables, cuts and merged specs, without running anything."""

from dataclasses import replace

import pytest

from geraf2.apps.benchmark import Case, RowResult, load_suite, rows_of
from geraf2.apps.benchmark.pages import make_table


@pytest.fixture(scope="module")
def suite():
    return load_suite(quick=True)


def results_of(suite, **figures):
    """F1 at 5 mm and Chamfer of each method in all its rows of the first table; None: it failed."""
    rows = [row for row in rows_of(suite) if row.experiment == "table1"]
    out = []
    for row in rows:
        f1, chamfer = figures[row.method.replace("-", "_")]
        error = None if f1 is not None else "it broke"
        out.append((row, RowResult(f1_5mm=f1, chamfer_1e3_m2=chamfer, error=error)))
    return out


def test_a_case_changes_constants_of_its_method_alone(suite):
    preset = suite.config("paper")
    case = Case(label="short", settings={"paper": {"stage2": {"n_steps": 10}, "ulos": False}})
    changed = suite.config("paper", case).paper
    assert changed.stage2 == replace(preset.paper.stage2, n_steps=10)
    assert replace(changed, stage2=preset.paper.stage2, ulos=True) == preset.paper


ONE_FAILED = {"fast": (0.9, 0.01), "matched_filter": (0.5, 0.2), "back_projection": (None, None)}


def test_means_are_over_all_scenes_and_leave_out_what_failed(suite):
    results = results_of(suite, **ONE_FAILED)
    table = make_table("table1", suite, results)
    assert table.head[:4] == ("scene", "method", "F1 5 mm", "CD [1e-3 m2]")
    means = [row for row in table.rows if row[0].startswith("mean")]
    assert [row[:4] for row in means] == [
        ("mean of 2", "geraf2, fast", "0.900", "0.0100"),
        ("mean of 2", "matched filter", "0.500", "0.2000"),
    ]
    assert len(table.failures) == 2
    assert all(len(row) == len(table.head) for row in table.rows)


SUITE = """
[scenes.a]
[scenes.b]
[methods.fast]
title = "default"
options = { trust_los = true }
[methods.other]
title = "other method"
[experiments.plain]
title = "Another"
scenes = ["a"]
methods = ["fast"]
[experiments.world]
title = "Rungs"
by_name = true
scenes = ["a", "b"]
methods = ["fast", "other"]
scene = { scan = { n_poses = 5 } }
cases = [
  { label = "ideal" },
  { label = "bent", scene.world.wall_bulge_m = 0.003, scene.scan.spacing_m = 0.01 },
  { label = "not made" },
]
"""


def test_an_experiment_runs_by_name_with_its_own_scan_and_options(suite_of):
    suite = suite_of(SUITE)
    assert {row.experiment for row in rows_of(suite)} == {"plain"}
    rows = rows_of(suite, ("world",))
    assert {row.spec.scan.n_poses for row in rows} == {5}
    bent = [row.spec for row in rows if row.case.label == "bent"]
    assert {(s.scan.spacing_m, s.world.wall_bulge_m) for s in bent} == {(0.01, 0.003)}
    assert [row.how.run_options(3).trust_los for row in rows[:2]] == [True, False]
    assert rows[0].how.run_options(3).seed == 3
