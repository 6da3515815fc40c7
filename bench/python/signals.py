"""Signals at random moments of every long command: does each end, and continue, as it should?

    python bench/python/signals.py [--trials 700] [--seed 0] [--commands reconstruct image ...]
    python bench/python/signals.py --pairs 20

A trial starts a command on a small capture, sends SIGINT, SIGTERM (five of seven) or SIGKILL at a
random moment of the processor time that it takes, and asks for
- exit code 130 or 143 (or death by that very signal, before Python runs and after SIGKILL), or 0
  where it was done before the signal came; and no more than one line of error;
- a true sentence: after "nothing was written" no file is another;
- no file half-written: each one that the folder's own record names has the recorded digest;
- the same bytes as without the signal, once the command is given again;
- no temporary file left then.
A line a failure, and the counts at the end; exit code 1 if any trial failed. With --counts FILE
they are kept after each trial, and the same command continues from there. Nine trials of ten are
forks of a process that has every library loaded, which takes a third of the time: their moments
fall on the work. Those of the others fall on the imports, too. Wants Linux.

With --pairs two runs of other settings start in one folder, the second up to the time of a run
later: each ends with exit code 0, or with 2 and the reason, and the folder holds one of the two
results to the last byte.
"""

import argparse
import atexit
import hashlib
import importlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line has it
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from geraf2.cli import main as command_line
from geraf2.errors import UserError
from geraf2.pipeline.commands.verify import verify
from reconstruct import SMALL_SPEC, geraf2_command

SPEC = SMALL_SPEC.format(n_poses=4, spacing_m=0.006, aperture_m=[0.12, 0.14])
PYTHON_STARTS_S = 0.06
"""Processor time in which Python starts and imports the entry point [s]."""
FAST = ["--preset", "fast", "--fit.spacing-m", "0.012"]
BOX = ["--box", "0.2", "0.2", "0.2"]
SIGNALS = (signal.SIGINT, signal.SIGTERM) * 2 + (signal.SIGKILL, signal.SIGINT, signal.SIGKILL)
FORKS_OF = 10
"""Of so many trials all but one are forks."""
# Times of day and durations; everything else is the same in every run.
CHANGING = ("run.json", "log.jsonl", "report.html")


@dataclass(frozen=True)
class Command:
    """A command whose last word but flags is OUT, a copy of `before` at first."""

    words: list[str]
    before: Path | None = None


def commands(folder: Path, names: list[str] | None = None) -> dict[str, Command]:
    """Every long command, or some, on one small scene; a word {} stands for OUT."""
    (folder / "spec.toml").write_text(SPEC, encoding="utf-8")
    scene, run, plain = folder / "scene", folder / "run", folder / "plain"
    call("simulate", str(folder / "spec.toml"), str(scene))
    quick = ["reconstruct", str(scene), "{}", *BOX, *FAST, "--no-report"]
    coarse = ["--spacing-m", "0.02", "--echo.max-edge-m", "0.006", "--echo.wall-edge-m", "0.01"]
    coarse += ["--echo.n-planes", "1", "--echo.n-targets", "50", "--angles", "0"]
    every = {
        "simulate": Command(["simulate", str(folder / "spec.toml"), "{}"]),
        "calibrate": Command(["calibrate", str(scene), "{}", *BOX]),
        "los": Command(["los", str(scene / "los.ply"), "{}"]),
        "image": Command(["image", str(scene), "{}", "--spacing-m", "0.01"]),
        "reconstruct": Command(quick[:-1]),
        "fast": Command([*quick, "--calibrate", "no"]),
        "replaced": Command([*quick, "--overwrite"], plain),
        "evaluate": Command(
            ["evaluate", "{}", "--truth", str(scene / "truth.ply"), "--n-samples", "500"], run
        ),
        "render": Command(["render", "{}", *coarse], run),
    }
    chosen = {name: every[name] for name in names or every}
    for base, more in ((run, []), (plain, ["--calibrate", "no"])):
        if any(command.before == base for command in chosen.values()):
            call(*(word.replace("{}", str(base)) for word in quick), *more)
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


class Process:
    """A geraf2 of its own: a new process, or a fork of this one, which skips the imports.

    A fork must not come after threads of OpenMP: this process computes nothing.
    """

    def __init__(self, words: list[str], printed: Path, *, fork: bool) -> None:
        self._printed, self.cpu_s = printed, 0.0
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
        if fork:
            # A signal waits until the fork is no longer this script.
            signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS[:2])
            self.pid = os.fork()
            if self.pid == 0:
                os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
                os.dup2(os.open(printed, flags), 2)
                self._run(words)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS[:2])
            return
        actions = [
            (os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0),
            (os.POSIX_SPAWN_OPEN, 2, str(printed), flags, 0o600),
        ]
        command = [*geraf2_command(), *words]
        self.pid = os.posix_spawn(command[0], command, os.environ, file_actions=actions)

    def _run(self, words: list[str]) -> None:
        code = 1
        try:
            try:
                atexit._clear()  # of the process that it was: it removes temporary folders
                for number in (signal.SIGINT, signal.SIGTERM):  # until geraf2 takes them
                    signal.signal(number, signal.SIG_DFL)
                signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS[:2])
                sys.argv = ["geraf2", *words]
                command_line.run()
            except SystemExit as end:
                code = end.code if isinstance(end.code, int) else 1
            signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS[:2])  # geraf2 would be gone here
            atexit._run_exitfuncs()
            self._printed.with_suffix(".modules").write_text("\n".join(sys.modules))
            sys.stderr.flush()
        finally:  # never on into the script: it removes its folder
            os._exit(code)

    def wait_for(self, cpu_s: float) -> None:
        """Return once it has taken this much processor time [s], or ended."""
        while self._taken() < cpu_s:
            if os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
                return
            time.sleep(0.002)

    def _taken(self) -> float:
        nanoseconds = 0
        for task in Path(f"/proc/{self.pid}/task").glob("*/schedstat"):
            with suppress(OSError, IndexError):  # a thread that has just ended
                nanoseconds += int(task.read_text().split()[0])
        return 1e-9 * nanoseconds

    def end(self) -> tuple[int, str]:
        """Exit code, negative after a signal, and the text of stderr."""
        _, status, usage = os.wait4(self.pid, 0)
        self.cpu_s = usage.ru_utime + usage.ru_stime
        return os.waitstatus_to_exitcode(status), self._printed.read_text(errors="replace")


class Bench:
    """Commands, what each leaves without a signal, and how much processor time it takes."""

    def __init__(
        self, folder: Path, names: list[str] | None = None, *, forks: bool = False
    ) -> None:
        if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # which commands would inherit
            signal.signal(signal.SIGINT, signal.default_int_handler)
        self.folder = folder
        self.forks = forks
        self.commands = commands(folder, names)
        self._known: dict[tuple[str, bool], tuple[dict[str, str], float]] = {}

    def undisturbed(self, name: str, *, fork: bool = False) -> tuple[dict[str, str], float]:
        """Files without a signal, and processor time [s]."""
        if (name, fork) not in self._known:
            for _ in range(1 + fork):  # the first one finds out what is imported
                out = self._fresh(name)
                process = self._start(name, out, fork=fork)
                code, printed = process.end()
                if code != 0:
                    sys.exit(f"{name}: {printed.strip()}")
                if fork:
                    self._import_its_modules()
            self._known[name, fork] = results_of(out), process.cpu_s
        return self._known[name, fork]

    def trial(
        self, name: str, number: signal.Signals, moment: float, *, fork: bool = False
    ) -> tuple[str, list[str]]:
        """Send a signal at a share of the time that the command takes -> how it ended, faults."""
        wanted, cpu_s = self.undisturbed(name, fork=fork)
        out = self._fresh(name)
        before = files_of(out.parent)
        process = self._start(name, out, fork=fork)
        process.wait_for(moment * cpu_s)
        os.kill(process.pid, number)
        code, printed = process.end()
        ended = {0: "done before", -number: "killed"}.get(code, "stopped")
        # While Python starts, SIGINT is its own affair: it reports it at length, or that it could
        # not start, or loses it in a callback of an import. geraf2's handler is there with run().
        early = number == signal.SIGINT and "in run" not in printed
        early &= code == -number or (not fork and moment * cpu_s < PYTHON_STARTS_S)
        words = () if early else ("Traceback", "internal error", "Fatal")
        faults = [f"{text} in: {printed[-900:]}" for text in words if text in printed]
        code_fits = code in (0, -number) or (code == 128 + number and number != signal.SIGKILL)
        if not code_fits and not early:
            faults.append(f"exit code {code}: {printed[-300:]}")
        untouched = files_of(out.parent) == before
        if "nothing was written" in printed and not untouched:
            faults.append("something was written")
        if out.is_dir() and any(out.iterdir()) and name != "los":
            faults += _corrupt(out)
        if not untouched:  # else it would start as it did
            faults += self._again(name, out, wanted, fork=fork)
        return ended, faults

    def _again(self, name: str, out: Path, wanted: dict[str, str], *, fork: bool) -> list[str]:
        code, printed = self._start(name, out, fork=fork).end()
        if code != 0:
            return [f"again: exit code {code}: {printed[-300:]}"]
        got = results_of(out)
        different = sorted(n for n in wanted.keys() | got.keys() if got.get(n) != wanted.get(n))
        left = [f"left: {p.name}" for p in out.parent.rglob(".*.tmp*")]
        return [*(f"again: {n} differs" for n in different), *left]

    def _fresh(self, name: str) -> Path:
        base = self.folder / "trial"
        shutil.rmtree(base, ignore_errors=True)
        base.mkdir()
        before = self.commands[name].before
        if before is not None:
            shutil.copytree(before, base / "out")
        return base / "out"

    def _start(self, name: str, out: Path, *more: str, fork: bool) -> Process:
        words = [word.replace("{}", str(out)) for word in self.commands[name].words]
        return Process([*words, *more], self.folder / "said", fork=fork)

    def _import_its_modules(self) -> None:
        for name in (self.folder / "said.modules").read_text().split():
            with suppress(Exception):
                importlib.import_module(name)


def _corrupt(out: Path) -> list[str]:
    try:
        verify(out)
    except UserError as error:
        return [f"corrupt: {error}"]
    return []


def run_trials(
    bench: Bench, n_trials: int, seed: int, report: Callable[[str], None], kept: Path | None = None
) -> int:
    """Make trials, commands and signals in turn -> how many failed, in all slices.

    kept: file of counts, from which a later call continues.
    """
    record = {"seed": seed, "trials": 0, "counts": {}, "failures": []}
    if kept is not None and kept.exists():
        record = json.loads(kept.read_text(encoding="utf-8"))
    names, counts = list(bench.commands), Counter[str](record["counts"])
    for trial in range(record["trials"], n_trials):
        name, number = names[trial % len(names)], SIGNALS[trial // len(names) % len(SIGNALS)]
        moment = random.Random(f"{record['seed']} {trial}").uniform(0.0, 1.1)
        fork = bench.forks and trial % FORKS_OF != 0
        ended, faults = bench.trial(name, number, moment, fork=fork)
        counts[f"{name} {number.name} {ended}"] += 1
        if faults:
            record["failures"].append(
                f"trial {trial}: {name} {number.name} at {moment:.2f}: {'; '.join(faults)}"
            )
            report(record["failures"][-1])
        record |= {"trials": trial + 1, "counts": dict(sorted(counts.items()))}
        if kept is not None:
            kept.write_text(json.dumps(record, indent=1), encoding="utf-8")
    of_signal = Counter[str]()
    for what, n in counts.items():
        of_signal[what.partition(" ")[2]] += n
    parts = ", ".join(f"{what} {n}" for what, n in sorted(of_signal.items()))
    report(f"{record['trials']} signals: {parts}; {len(record['failures'])} failed")
    return len(record["failures"])


def run_pairs(folder: Path, n_pairs: int, seed: int, report: Callable[[str], None]) -> int:
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
        printed = [process.communicate()[1] for process in running]
        codes = sorted(process.returncode for process in running)
        counts[f"exit codes {codes}"] += 1
        reason = (
            "another command is writing",
            "another result was written here meanwhile",
            "a finished mesh of other settings",
        )
        refused = [text for p, text in zip(running, printed, strict=True) if p.returncode == 2]
        good = codes == [0, 2] and all(any(w in text for w in reason) for text in refused)
        if not (good and results_of(out) in wanted):
            n_failed += 1
            report(f"pair {pair}: exit codes {codes}; {[text[-200:] for text in printed]}")
    report(f"{n_pairs} pairs: {dict(counts)}; {n_failed} failed")
    return n_failed


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=700)
    parser.add_argument("--counts", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--commands", nargs="+")
    parser.add_argument("--pairs", type=int, default=0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder, seed = Path(scratch), arguments.seed

        def report(text: str) -> None:
            print(text, flush=True)

        if arguments.pairs:
            failed = run_pairs(folder, arguments.pairs, seed, report)
        else:
            bench = Bench(folder, arguments.commands, forks=True)
            failed = run_trials(bench, arguments.trials, seed, report, arguments.counts)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
