"""Pages of a benchmark: pictures and tables."""

import pytest

from geraf2.apps.benchmark import RowResult, rows_of, write_pages

VERSUS = """
[scenes.a]
[scenes.b]
[methods.fast]
title = "default"
[methods.other]
title = "other method"
[methods.bound]
title = "bound"
kind = "oracle"
preset = "matched-filter"
[experiments.table]
title = "Table"
scenes = ["a", "b"]
methods = ["fast", "other", "bound"]
"""


def test_the_best_of_the_methods_is_bold_but_neither_a_bound_nor_a_row_alone(tmp_path, suite_of):
    suite = suite_of(VERSUS)
    results = {
        ("a", "fast"): RowResult(f1_5mm=0.9, chamfer_1e3_m2=0.2, cpu_seconds=9.0),
        ("a", "other"): RowResult(f1_5mm=0.8, chamfer_1e3_m2=0.1, cpu_seconds=1.0),
        ("a", "bound"): RowResult(f1_5mm=0.95, chamfer_1e3_m2=0.3),
        ("b", "fast"): RowResult(f1_5mm=0.7, chamfer_1e3_m2=0.2, cpu_seconds=9.0),
        ("b", "other"): RowResult(error="failed"),
        ("b", "bound"): RowResult(f1_5mm=0.6, chamfer_1e3_m2=0.4),
    }
    rows = [(row, results[row.scene, row.method]) for row in rows_of(suite)]
    page = write_pages(tmp_path, suite, rows).read_text(encoding="utf-8")
    assert '<a href="#table">Table</a>' in page
    assert '<h2 id="table">Table</h2>' in page
    assert "<td><b>0.900</b></td>" in page
    assert "<td><b>0.1000</b></td>" in page
    for alone in ("0.950", "0.700", "0.2000", "1", "9"):
        assert f"<td><b>{alone}</b></td>" not in page


@pytest.mark.parametrize(("n_known", "drawn"), [(2, False), (3, True)])
def test_a_sweep_is_drawn_of_three_settings_and_more_with_results(
    tmp_path, suite_of, n_known, drawn
):
    labels = [f'{{ label = "{name}" }}' for name in "abcd"]
    suite = suite_of(f"{VERSUS}cases = [{', '.join(labels)}]\n")
    good, failed = RowResult(f1_15mm=0.9, f1_5mm=0.8), RowResult(error="failed")
    known = "abcd"[:n_known]
    results = [(row, good if row.case.label in known else failed) for row in rows_of(suite)]
    write_pages(tmp_path, suite, results)
    assert (tmp_path / "figures" / "table_sweep.png").is_file() == drawn


LADDER = """
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
ladder = true
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


def test_a_ladder_runs_by_name_with_its_own_scan_and_options(suite_of):
    suite = suite_of(LADDER)
    assert {row.experiment for row in rows_of(suite)} == {"plain"}
    rows = rows_of(suite, ("world",))
    assert {row.spec.scan.n_poses for row in rows} == {5}
    bent = [row.spec for row in rows if row.case.label == "bent"]
    assert {(s.scan.spacing_m, s.world.wall_bulge_m) for s in bent} == {(0.01, 0.003)}
    assert [row.how.run_options(3).trust_los for row in rows[:2]] == [True, False]
    assert rows[0].how.run_options(3).seed == 3
