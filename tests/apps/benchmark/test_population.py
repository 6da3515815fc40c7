"""Seeds, results that are kept, and the statistics of the population's table."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.apps.benchmark import RowResult, Runner, population
from geraf2.apps.benchmark.making import population_scores
from geraf2.apps.benchmark.population import (
    SETS,
    Population,
    append_result,
    parse_seeds,
    read_results,
)
from geraf2.apps.benchmark.population_table import (
    SeedResult,
    mean_interval,
    paired_table,
    preset_table,
    quantile_change,
)
from geraf2.scene import LosPrior
from geraf2.simulation import FigureSpec, SceneSpec


def result(seed, f1, *, preset="fast", version="v", error=None):
    scores = {} if error else {"f1_5mm": f1, "cpu_seconds": 2.0}
    return SeedResult(seed=seed, preset=preset, version=version, scores=scores, error=error)


def test_seeds_are_a_half_open_range():
    assert parse_seeds("1000:1040") == range(1000, 1040)
    assert not population.is_reserved(parse_seeds("9990:10000"))
    assert population.is_reserved(parse_seeds("9990:10001"))


def test_the_interval_of_a_mean_is_that_of_the_central_limit_theorem():
    values = np.random.default_rng(1).normal(3.0, 2.0, 400)
    mean = mean_interval(values)
    half = 1.96 * values.std() / np.sqrt(len(values))
    assert mean.value == pytest.approx(values.mean())
    # 2000 resamples estimate each bound to 3 % of the half width, one standard deviation.
    assert [mean.low, mean.high] == pytest.approx(
        [values.mean() - half, values.mean() + half], abs=0.12 * half
    )


def test_pairs_stay_pairs():
    before = np.random.default_rng(2).normal(size=300)
    # What all pairs have in common is known exactly, however much the pairs differ.
    assert quantile_change(before, before + 0.25) == pytest.approx((0.25, 0.25, 0.25))
    first = [result(seed, 0.5 + 0.001 * seed) for seed in range(20)]
    second = [result(seed, 0.6 + 0.001 * seed, preset="best") for seed in range(5, 30)]
    lines = paired_table("best less fast", first, second)
    assert "15 seeds" in lines[0]
    assert "+0.100     +0.100 to +0.100" in lines[2]
    assert lines[2].endswith("15/15")
    assert paired_table("none", first[:2], second) == ["none: no seed in common"]


def test_an_error_counts_as_zero_and_as_a_failure():
    results = [result(seed, 0.9) for seed in range(8)]
    results += [result(8, 0.4), result(9, 0.0, error="it broke")]
    lines = preset_table("fast", results)
    assert "10 seeds, 2 failed (20.0%): 1 with an error, 1 with F1" in lines[0]
    assert f"{(8 * 0.9 + 0.4) / 10:.3f}" in lines[2]
    assert lines[-1] == "  failed: 9, 8"
    cpu = next(line for line in lines if "CPU" in line)
    assert cpu.endswith("9")  # of nine runs only


def test_scores_of_a_cube_that_is_too_large():
    mesh, truth = (LosPrior.from_box((s, s, s)).mesh for s in (0.104, 0.1))
    scores = population_scores(mesh, truth, 0)
    assert scores["volume_ratio"] == pytest.approx(1.04**3)
    assert [scores[f"extent_{axis}_mm"] for axis in "xyz"] == pytest.approx([4.0] * 3)
    assert scores["offset_mm"] == pytest.approx(2.0, abs=0.01)
    # At 2 mm from the other surface lies all of it but the edges, and no sample is nearer.
    assert scores["f1_2mm"] == 0.0
    assert scores["f1_5mm"] == 1.0
    assert "within_one" not in scores
    assert "volume_covered" not in scores
    stated = {
        "volume_95_percent_cm3": [990.0, 1200.0],
        "extents_95_percent_mm": [[99.0, 109.0], [100.5, 107.0], [95.0, 101.0]],
    }
    scores = population_scores(mesh, truth, 0, stated=stated)
    assert scores["volume_covered"] == 1.0
    assert scores["extents_covered"] == pytest.approx(2 / 3)


class StandIn(Runner):
    """Makes no scene; its rows have the F1 that a test gives. Keeps the seeds that it made."""

    def run_all(self, rows, reported, *, jobs=1, scheduler=None):
        made = []
        for row in rows:
            f1 = self.values[row.seed]
            scores = None if f1 is None else {"f1_5mm": f1}
            found = RowResult(f1_5mm=f1, scores=scores, error=None if f1 else "it broke")
            reported(row, found)
            self.seeds.append(row.seed)
            made.append((row, found))
        return made


@pytest.fixture
def task(tmp_path, monkeypatch):
    spec = SceneSpec(figure=FigureSpec(name="llama"))
    monkeypatch.setattr(population, "scene_of", lambda folder, scenes, seed: spec)
    runner = StandIn(out=tmp_path)
    runner.values, runner.seeds = {1: 0.5, 2: None, 3: 0.7}, []
    return Population(runner=runner, presets=("fast",))


def test_a_second_run_makes_only_what_is_missing_or_failed(task):
    first = task.run([1, 2])
    assert [r.score("f1_5mm") for r in first] == [0.5, 0.0]
    task.runner.values = {1: 0.1, 2: 0.6, 3: 0.7}
    for _ in range(2):
        again = task.run([1, 2, 3])
        assert [r.score("f1_5mm") for r in again] == [0.5, 0.6, 0.7]
    assert task.runner.seeds == [1, 2, 2, 3]


def test_a_line_that_was_cut_short_is_made_again(task):
    task.run([1, 3])
    path = task.runner.out / SETS["population"].results_name
    path.write_text(path.read_text()[:-20])
    assert [r.seed for r in read_results(path)] == [1]
    append_result(path, result(7, 0.3))
    assert [r.seed for r in read_results(path)] == [1, 7]
    task.run([1, 3])
    assert task.runner.seeds == [1, 3, 3]


def test_results_of_another_version_are_not_taken(task):
    task.run([1])
    path = task.runner.out / SETS["population"].results_name
    (old,) = (replace(r, version="old") for r in read_results(path))
    path.unlink()
    append_result(path, old)
    task.run([1])
    assert task.runner.seeds == [1, 1]
    # Against another folder its last results count, whatever their version.
    assert [r.seed for r in population.results_against(task.runner.out, task.scenes)] == [1]
