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


def test_some_methods_are_coarser_in_the_short_form(suite):
    short, whole = (one.config("matched-filter").matched_filter for one in (suite, load_suite()))
    assert short.spacing_m > whole.spacing_m


ONE_FAILED = {"fast": (0.9, 0.01), "matched_filter": (0.5, 0.2), "back_projection": (None, None)}


def test_means_are_over_all_scenes_and_leave_out_what_failed(suite):
    results = results_of(suite, **ONE_FAILED)
    table = make_table("table1", suite.experiments["table1"], suite, results)
    assert table.head[:4] == ("scene", "method", "F1 5 mm", "CD [1e-3 m2]")
    means = [row for row in table.rows if row[0].startswith("mean")]
    assert [row[:4] for row in means] == [
        ("mean of 2", "geraf2, fast", "0.900", "0.0100"),
        ("mean of 2", "matched filter", "0.500", "0.2000"),
    ]
    assert len(table.failures) == 2
    assert all(len(row) == len(table.head) for row in table.rows)


def test_pieces_and_holes_are_shown_beside_those_of_the_truth_without_a_mean(suite):
    shown = [
        (row, replace(r, same_topology=float(r.f1_5mm == 0.9), topology="1, 0 (1, 2)"))
        for row, r in results_of(suite, **ONE_FAILED)
        if r.error is None
    ]
    table = make_table("table1", suite.experiments["table1"], suite, shown)
    column = table.head.index("pieces, holes (true)")
    assert {row[column] for row in table.rows} == {"1, 0 (1, 2)", ""}
    assert all(row[column] == "" for row in table.rows if row[0].startswith("mean"))
    assert not {of for _, of in table.best} & {column}
    rights = [row[column - 1] for row in table.rows if row[0].startswith("mean")]
    assert rights == ["1.00", "0.00"]


def test_sizes_are_beside_f1_and_the_best_is_the_nearest_to_the_truth(suite):
    sizes = {"fast": (1.02, -0.0012, 3e-4), "matched-filter": (0.90, 0.0014, -4e-4)}
    shown = []
    for row, r in results_of(suite, **ONE_FAILED):
        if r.error is None:
            volume, extent, offset = sizes[row.method]
            more = {"f1_2mm": r.f1_5mm - 0.1, "volume_ratio": volume, "offset_m": offset}
            shown.append((row, replace(r, extent_x_m=extent, extent_z_m=2 * extent, **more)))
    table = make_table("table1", suite.experiments["table1"], suite, shown)
    names = ("F1 2 mm", "volume / true", "extent x [mm]", "extent z [mm]", "offset [mm]")
    columns = [table.head.index(name) for name in names]
    numbers = [[row[c] for c in columns] for row in table.rows[:2]]
    assert numbers == [
        ["0.800", "1.020", "-1.2", "-2.4", "0.30"],
        ["0.400", "0.900", "1.4", "2.8", "-0.40"],
    ]
    assert {(0, column) for column in columns} <= table.best
    assert not {(1, column) for column in columns} & table.best
    assert shown[0][1].extent_m == 2 * 0.0012
    assert RowResult().extent_m is None
