"""Signals at random moments of every long command: does each end, and go on, as it should?

    python bench/python/signals.py [--trials 500] [--seed 0] [--commands reconstruct image ...]
    python bench/python/signals.py --pairs 20

A trial starts a command on a small capture, sends SIGINT, SIGTERM or SIGKILL at a random moment of
the time that it takes, and asks for
- exit code 130 or 143 (or death by that very signal, before Python runs and after SIGKILL), or 0
  where it was done before the signal came; and no more than one line of error;
- a true sentence: after "nothing was written" no file is another;
- no file half-written: each one that the folder's own record names is as it says;
- the same bytes as without the signal, once the command is given again;
- no temporary file left then.
A line a failure, and one with the counts at the end; exit code 1 if any trial failed.

With --pairs two runs of other settings start in one folder, the second up to the time of a run
later: each ends with exit code 0, or with 2 and the reason, and the folder holds one of the two
results to the last byte.
"""

import argparse
import hashlib
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from geraf2.errors import UserError
from geraf2.pipeline.verify import verify
from reconstruct import geraf2_command

SPEC = """
[figure]
name = "llama"
height_m = 0.11
[[walls]]
size_m = [0.20, 0.20, 0.20]
[scan]
n_poses = 4
spacing_m = 0.006
aperture_m = [0.12, 0.14]
[numerics]
wall_patch_m = 0.02
antenna_block_m = 0.07
"""
FAST = ["--fit.spacing-m", "0.012", "--fit.coarse-spacing-m", "0.016", "--fit.distance-rounds", "1"]
BOX = ["--box", "0.2", "0.2", "0.2"]
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
# What tells the time or how long something took; everything else is the same in every run.
CHANGING = ("run.json", "log.jsonl", "report.html", "checksums.json")


@dataclass(frozen=True)
class Command:
    """A command whose last word but flags is OUT, a copy of `before` at first."""

    words: list[str]
    before: Path | None = None
    again: tuple[str, ...] = ()
    """Flags with which it goes on after a stop."""


def commands(folder: Path, names: list[str] | None = None) -> dict[str, Command]:
    """Every long command, or some, on one small scene; a word {} stands for OUT."""
    (folder / "spec.toml").write_text(SPEC, encoding="utf-8")
    scene, run, plain = folder / "scene", folder / "run", folder / "plain"
    call("simulate", str(folder / "spec.toml"), str(scene))
    quick = ["reconstruct", str(scene), "{}", *BOX, *FAST, "--no-report"]
    coarse = ["--spacing-m", "0.02", "--echo.max-edge-m", "0.006", "--echo.wall-edge-m", "0.01"]
    coarse += ["--echo.n-planes", "1", "--echo.n-targets", "200", "--angles", "0"]
    every = {
        "simulate": Command(["simulate", str(folder / "spec.toml"), "{}"]),
        "calibrate": Command(["calibrate", str(scene), "{}", *BOX]),
        "los": Command(["los", str(scene / "los.ply"), "{}"]),
        "image": Command(["image", str(scene), "{}", "--spacing-m", "0.005"]),
        "reconstruct": Command(quick[:-1], again=("--resume",)),
        "fast": Command([*quick, "--calibrate", "no"], again=("--resume",)),
        "replaced": Command([*quick, "--overwrite"], plain, again=("--resume",)),
        "evaluate": Command(["evaluate", "{}", "--truth", str(scene / "truth.ply")], run),
        "render": Command(["render", "{}", *coarse], run),
    }
    chosen = {name: every[name] for name in names or every}
    for place, more in ((run, []), (plain, ["--calibrate", "no"])):
        if any(command.before == place for command in chosen.values()):
            call(*(word.replace("{}", str(place)) for word in quick), *more)
    return chosen


def call(*words: str) -> None:
    done = subprocess.run([*geraf2_command(), *words], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"geraf2 {' '.join(words)}: {done.stderr.strip()}")


def files_of(folder: Path) -> dict[str, str]:
    """Hash of each file in a folder."""
    return {
        p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


def results_of(folder: Path) -> dict[str, str]:
    """Those that are the same in every run."""
    return {n: d for n, d in files_of(folder).items() if Path(n).name not in CHANGING}


class Bench:
    """Commands, what each leaves without a signal, and how long it takes."""

    def __init__(self, folder: Path, names: list[str] | None = None) -> None:
        if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # which commands would inherit
            signal.signal(signal.SIGINT, signal.default_int_handler)
        self.folder = folder
        self.commands = commands(folder, names)
        self._known: dict[str, tuple[dict[str, str], float]] = {}

    def undisturbed(self, name: str) -> tuple[dict[str, str], float]:
        """Files without a signal, and seconds."""
        if name not in self._known:
            out, start = self._fresh(name), time.perf_counter()
            call(*self._words(name, out))
            self._known[name] = results_of(out), time.perf_counter() - start
        return self._known[name]

    def trial(self, name: str, number: signal.Signals, moment: float) -> tuple[str, list[str]]:
        """Send a signal at a share of the time that the command takes -> how it ended, faults."""
        wanted, seconds = self.undisturbed(name)
        out = self._fresh(name)
        before = files_of(out) if out.is_dir() else {}
        process = subprocess.Popen(
            [*geraf2_command(), *self._words(name, out)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        time.sleep(moment * seconds)
        process.send_signal(number)
        said, faults = process.communicate()[1], []
        code = process.returncode
        ended = {0: "done before", -number: "killed"}.get(code, "stopped")
        faults += [text for text in ("Traceback", "internal error", "Fatal") if text in said]
        if code not in (0, -number) and (code != 128 + number or number == signal.SIGKILL):
            faults.append(f"exit code {code}: {said[-300:]}")
        if "nothing was written" in said and (files_of(out) if out.is_dir() else {}) != before:
            faults.append("something was written")
        if out.is_dir() and any(out.iterdir()) and name != "los":
            faults += _corrupt(out)
        again = subprocess.run(
            [*geraf2_command(), *self._words(name, out), *self.commands[name].again],
            capture_output=True,
            text=True,
            check=False,
        )
        if again.returncode != 0:
            faults.append(f"again: exit code {again.returncode}: {again.stderr[-300:]}")
        else:
            got = results_of(out)
            faults += [
                f"again: {n} differs"
                for n in sorted(wanted.keys() | got.keys())
                if got.get(n) != wanted.get(n)
            ]
        faults += [f"left: {p.name}" for p in out.parent.rglob(".*.tmp*")]
        return ended, faults

    def _fresh(self, name: str) -> Path:
        place = self.folder / "trial"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        before = self.commands[name].before
        if before is not None:
            shutil.copytree(before, place / "out")
        return place / "out"

    def _words(self, name: str, out: Path) -> list[str]:
        return [word.replace("{}", str(out)) for word in self.commands[name].words]


def _corrupt(out: Path) -> list[str]:
    try:
        verify(out)
    except UserError as error:
        return [f"corrupt: {error}"]
    return []


def run_trials(bench: Bench, n_trials: int, seed: int, told: Callable[[str], None]) -> int:
    """Make trials, commands and signals in turn -> how many failed."""
    rng, counts, n_failed = random.Random(seed), Counter[str](), 0
    names = list(bench.commands)
    for trial in range(n_trials):
        name, number = names[trial % len(names)], SIGNALS[trial // len(names) % len(SIGNALS)]
        moment = rng.uniform(0.0, 1.1)
        ended, faults = bench.trial(name, number, moment)
        counts[f"{number.name} {ended}"] += 1
        if faults:
            n_failed += 1
            told(f"{name} {number.name} at {moment:.2f}: {'; '.join(faults)}")
    parts = ", ".join(f"{what} {n}" for what, n in sorted(counts.items()))
    told(f"{n_trials} signals: {parts}; {n_failed} failed")
    return n_failed


def run_pairs(folder: Path, n_pairs: int, seed: int, told: Callable[[str], None]) -> int:
    """Make pairs of concurrent runs -> how many failed."""
    rng, counts, n_failed = random.Random(seed), Counter[str](), 0
    scene, out, wanted, took = folder / "scene", folder / "pair", list[dict[str, str]](), 0.0
    (folder / "spec.toml").write_text(SPEC, encoding="utf-8")
    call("simulate", str(folder / "spec.toml"), str(scene))
    quick = ["reconstruct", str(scene), str(out), *BOX, *FAST, "--no-report", "--calibrate", "no"]
    both = [quick, [*quick, "--fit.bending-weight", "0.5"]]
    for words in both:
        shutil.rmtree(out, ignore_errors=True)
        start = time.perf_counter()
        call(*words)
        took = time.perf_counter() - start
        wanted.append(results_of(out))
    for pair in range(n_pairs):
        shutil.rmtree(out, ignore_errors=True)
        running = []
        for words in both if pair % 2 else both[::-1]:
            command = [*geraf2_command(), *words]
            running.append(subprocess.Popen(command, stderr=subprocess.PIPE, text=True))
            time.sleep(rng.uniform(0.0, 0.5 * took) if len(running) == 1 else 0.0)
        said = [process.communicate()[1] for process in running]
        codes = sorted(process.returncode for process in running)
        counts[f"exit codes {codes}"] += 1
        told_why = ("another run is writing", "a finished mesh of other settings")
        refused = [text for p, text in zip(running, said, strict=True) if p.returncode == 2]
        good = codes == [0, 2] and all(any(w in text for w in told_why) for text in refused)
        if not (good and results_of(out) in wanted):
            n_failed += 1
            told(f"pair {pair}: exit codes {codes}; {[text[-200:] for text in said]}")
    told(f"{n_pairs} pairs: {dict(counts)}; {n_failed} failed")
    return n_failed


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--commands", nargs="+")
    parser.add_argument("--pairs", type=int, default=0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder, seed = Path(scratch), arguments.seed

        def told(text: str) -> None:
            print(text, flush=True)

        if arguments.pairs:
            failed = run_pairs(folder, arguments.pairs, seed, told)
        else:
            failed = run_trials(Bench(folder, arguments.commands), arguments.trials, seed, told)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
