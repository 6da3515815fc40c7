"""How the verdict of a run fits good and bad scans whose truth is known.

    python bench/python/verdict_scans.py --out DIR --set estimate
    python bench/python/verdicts.py run DIR [--preset fast] [--only KIND...]
    python bench/python/verdicts.py table DIR
    python bench/python/verdicts.py fit DIR
    python bench/python/verdicts.py cross DIR

`run` reconstructs each scan of a set without `--box` into DIR/runs, or into the folder that
`--runs` names, and appends a row to rows.jsonl there; it continues after a stop. `table` prints
what is asked of the verdict, with Wilson intervals of 90 %. A run that stops with an error counts
as not to be trusted, and its text as the cause. `fit` prints the log odds of a failure, of maximum
likelihood over the runs that were judged, by the evidence that their verdicts hold; without those
in the other sense, which may be mirror images. `cross` judges the scans of each object by weights
of all others.
"""

import argparse
import json
import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

import geraf2
from geraf2.evaluation import evaluate_mesh
from geraf2.io.mesh import read_mesh
from geraf2.pipeline.verdict import DOUBTFUL, FAILED
from geraf2.surfaces.stated_score import FAILED_BELOW, stated_f1

WORDS = {
    "height": ("height",),
    "few planes": ("few planes",),
    "delay": ("delay",),
    "sense": ("sense",),
    "axes": ("axes",),
    "swapped": ("swapped", "exchange", "order of the planes"),
    "saturated": ("saturat", "cut off"),
    "plastic": ("plastic",),
    "hard": ("hardware",),
}
"""By the cause of a bad scan, words of which a verdict's cause, or an error, has one if right."""
GOOD_F1 = 0.8
NOT_TRUSTED = "not to be trusted"


def run(out: Path, runs: Path, preset: str, kinds: list[str], *, again: bool) -> None:
    runs.mkdir(parents=True, exist_ok=True)
    file = runs / "rows.jsonl"
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    done = set() if again else {(row["name"], row["preset"]) for row in rows}
    records = sorted(out.glob("*.json"), key=lambda path: path.stat().st_mtime)
    for about in (json.loads(path.read_text()) for path in records):
        if (about["name"], preset) in done or (kinds and about["kind"] not in kinds):
            continue
        row = {name: about[name] for name in ("kind", "set", "name", "cause")} | {"preset": preset}
        row |= run_one(out, about, runs / f"{about['name']}-{preset}", preset)
        print_row(row)
        with file.open("a") as lines:
            lines.write(json.dumps(row) + "\n")


def run_one(out: Path, about: dict[str, Any], to: Path, preset: str) -> dict[str, Any]:
    start = time.process_time()
    try:
        result = geraf2.reconstruct(
            out / about["name"], None, preset, to, overwrite=True, num_threads=1
        )
    except geraf2.UserError as error:
        return {"error": str(error), "cpu_s": round(time.process_time() - start, 2)}
    cpu_s = round(time.process_time() - start, 2)
    truth, numbers = read_mesh(out / about["truth"]), result.numbers
    row = {"cpu_s": cpu_s, "warnings": result.run.warnings, "box": numbers.get("box", {})}
    mesh = {name: v for name, v in numbers["mesh"].items() if name != "likely_ghosts"}
    row |= {"mesh": mesh, "verdict": numbers.get("verdict", {})}
    row["object"] = about.get("object") or about.get("base") or about["name"]
    row["reversed_turn"] = numbers.get("calibration", {}).get("reversed_turn", 0)
    if not len(result.content_mesh.faces):
        return row | {"f1": 0.0}
    if result.verdict is not None and result.content_mesh.expected_error_m is not None:
        failure = result.verdict.probability_of_failure
        low, _, high = stated_f1(result.content_mesh, failure)
        row["verdict"] = row["verdict"] | {"f1_90_percent": [low, high]}
    scores = evaluate_mesh(result.content_mesh, truth, num_threads=1)
    errors = scores.expected_error
    row |= {"f1": scores.f1(0.005), "f1_15mm": scores.f1(0.015)}
    return row | ({} if errors is None else {"within_two": errors.within_two})


def said_by(row: dict[str, Any]) -> tuple[str, list[bool]]:
    """What the run says of itself, and of each cause that it names whether it is the right one."""
    verdict, words = row.get("verdict") or {}, WORDS.get(row["cause"], ())
    if "error" in row:
        said, texts = NOT_TRUSTED, [row["error"]]
    else:
        said = verdict.get("verdict", "nothing")
        texts = [" ".join(cause.values()) for cause in verdict.get("causes", [])]
    return said, [any(word in text.lower() for word in words) for text in texts]


def print_row(row: dict[str, Any]) -> None:
    f1 = "F1   -  " if "error" in row else f"F1 {row['f1']:.3f}"
    mm = row.get("mesh", {}).get("expected_error_median_mm", float("nan"))
    text = row.get("error", row.get("box", {}).get("by_radar", ""))
    causes = ", ".join(cause["name"] for cause in (row.get("verdict") or {}).get("causes", []))
    print(
        f"{row['name']:40s} {f1} stated {mm:5.2f} mm {row['cpu_s']:5.1f} s  {said_by(row)[0]}"
        f" ({causes})  {text[:150]}",
        flush=True,
    )


def wilson(n_yes: int, n: int, z: float = 1.645) -> str:
    """A share, and its limits at 90 % (Wilson, 1927)."""
    if not n:
        return "-"
    share, spread = n_yes / n, z**2 / n
    middle = (share + 0.5 * spread) / (1.0 + spread)
    half = np.sqrt(share * (1.0 - share) * spread + 0.25 * spread**2) / (1.0 + spread)
    return f"{n_yes}/{n} = {share:.2f} ({middle - half:.2f} to {middle + half:.2f})"


def share(rows: list[dict[str, Any]], test: Callable[[dict[str, Any]], object]) -> str:
    return wilson(sum(bool(test(row)) for row in rows), len(rows))


def read_rows(runs: Path, preset: str) -> list[dict[str, Any]]:
    """Last row of each scan; an F1 of 0 where the run stopped."""
    lines = [json.loads(line) for line in (runs / "rows.jsonl").read_text().splitlines()]
    last = {row["name"]: {"f1": 0.0} | row for row in lines if row["preset"] == preset}
    for row in last.values():
        row["said"], row["named"] = said_by(row)
    return list(last.values())


def table(runs: Path, preset: str) -> None:
    rows = read_rows(runs, preset)
    good = [row for row in rows if row["f1"] > GOOD_F1]
    print("| kind | scans | stopped | F1, least to most | bad: so called | good: so called |")
    print("|---|---|---|---|---|---|")
    for kind in dict.fromkeys(row["kind"] for row in rows):
        own = [row for row in rows if row["kind"] == kind]
        f1 = [row["f1"] for row in own if "error" not in row] or [float("nan")]
        counts = [
            share([row for row in some if row["kind"] == kind], lambda r: r["said"] == NOT_TRUSTED)
            for some in ([row for row in rows if row["f1"] < FAILED_BELOW], good)
        ]
        stopped = sum("error" in row for row in own)
        print(
            f"| {kind} | {len(own)} | {stopped} | {np.mean(f1):.3f}, {min(f1):.3f} to "
            f"{max(f1):.3f} | {' | '.join(counts)} |"
        )
    print_shares(rows)
    print(f"CPU seconds of a run: {np.mean([row['cpu_s'] for row in rows]):.1f}")


def print_shares(rows: list[dict[str, Any]]) -> None:
    """What is asked of the verdict."""
    bad = [row for row in rows if row["f1"] < FAILED_BELOW and row["cause"]]
    good = [row for row in rows if row["f1"] > GOOD_F1]
    said = [row for row in bad if row["said"] == NOT_TRUSTED]
    stated = [row for row in rows if "f1_90_percent" in (row.get("verdict") or {})]
    sure = [row for row in rows if row["said"] == "reliable" and "within_two" in row]
    print(f"bad scans called not to be trusted: {share(bad, lambda r: r['said'] == NOT_TRUSTED)}")
    print(f"good ones called so: {share(good, lambda r: r['said'] == NOT_TRUSTED)}")
    print(f"good ones called doubtful: {share(good, lambda r: r['said'] == 'doubtful')}")
    print(
        f"first cause right, of these bad ones: {share(said, lambda r: r['named'][:1] == [True])}"
    )
    print(f"one of the causes right: {share(said, lambda r: any(r['named']))}")
    print(f"stated 90 % interval of F1 holds: {share(stated, holds_f1)}")
    if sure:
        print(f"within two sigma, reliable scans: {np.mean([r['within_two'] for r in sure]):.3f}")
    print_probabilities(rows)


def holds_f1(row: dict[str, Any]) -> bool:
    low, high = row["verdict"]["f1_90_percent"]
    return bool(low <= row["f1"] <= high)


def print_probabilities(rows: list[dict[str, Any]]) -> None:
    """Stated probability that F1 is below FAILED_BELOW against how often it is."""
    name = "probability_of_failure"
    stated = [
        (r["verdict"][name], r["f1"] < FAILED_BELOW) for r in rows if name in r.get("verdict", {})
    ]
    for low, high in ((0.0, 0.02), (0.02, 0.1), (0.1, 0.5), (0.5, 0.9), (0.9, 1.01)):
        here = [failed for p, failed in stated if low <= p < high]
        to = min(high, 1.0)
        print(f"failed where {low:.2f} to {to:.2f} is stated: {wilson(sum(here), len(here))}")


def evidence_of(rows: list[dict[str, Any]]) -> np.ndarray:
    """One and the evidence of each judged run, (n_rows, 7)."""
    return np.array([[1.0, *row["verdict"]["tests"]["evidence"].values()] for row in rows])


def weights_of(rows: list[dict[str, Any]]) -> tuple[np.ndarray, float]:
    """Log odds and weights of maximum likelihood, and the log loss of a run."""
    rows = [row for row in rows if not row["reversed_turn"]]
    inputs = evidence_of(rows)
    failed = np.array([row["f1"] < FAILED_BELOW for row in rows])

    def loss(weights: np.ndarray) -> float:
        odds = inputs @ weights
        return float(np.logaddexp(0.0, np.where(failed, -odds, odds)).sum())

    limits = [(None, None)] + [(0.0, None)] * (inputs.shape[1] - 1)  # none speaks for a scan
    weights = minimize(loss, np.zeros(len(limits)), bounds=limits).x
    return weights, loss(weights) / len(rows)


def fit(runs: Path, preset: str) -> None:
    rows = [row for row in read_rows(runs, preset) if row.get("verdict")]
    weights, loss = weights_of(rows)
    print(f"{len(rows)} runs, log loss of those in the recorded sense {loss:.3f}")
    names = ("log odds", *rows[0]["verdict"]["tests"]["evidence"])
    for name, weight in zip(names, weights, strict=True):
        print(f"  {name:14s} {weight:6.2f}")


def cross(runs: Path, preset: str) -> None:
    rows = read_rows(runs, preset)
    judged = [row for row in rows if row.get("verdict")]
    for own in {row["object"] for row in judged}:
        weights, _ = weights_of([row for row in judged if row["object"] != own])
        for row in (row for row in judged if row["object"] == own):
            failure = float(expit(evidence_of([row]) @ weights)[0])
            row["verdict"]["probability_of_failure"] = failure
            sure = failure >= FAILED or row["reversed_turn"]
            row["said"] = NOT_TRUSTED if sure else "doubtful" if failure >= DOUBTFUL else "reliable"
    print_shares(rows)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    what = parser.add_subparsers(dest="what", required=True)
    ran, *others = (what.add_parser(name) for name in ("run", "table", "fit", "cross"))
    for own in (ran, *others):
        own.add_argument("set", type=Path, help="folder of a set")
        own.add_argument("--preset", default="fast")
        own.add_argument("--runs", type=Path, help="folder of the runs; SET/runs by default")
    ran.add_argument("--only", nargs="+", default=[], metavar="KIND")
    ran.add_argument("--again", action="store_true", help="run also what has a row")
    given = parser.parse_args()
    runs = given.runs or given.set / "runs"
    if given.what != "run":
        {"table": table, "fit": fit, "cross": cross}[given.what](runs, given.preset)
        return
    logging.getLogger("geraf2").setLevel(logging.CRITICAL)  # rows hold the warnings
    run(given.set, runs, given.preset, given.only, again=given.again)


if __name__ == "__main__":
    main()
