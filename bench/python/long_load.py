"""Many reconstructions in one process, and many processes at once: does anything grow or differ?

    python bench/python/long_load.py [--runs 200] [--processes 8]

Reconstructs the small capture of `geraf2.examples` again and again by the Python API, each time
into a temporary folder, draws every tenth report, and prints a line each tenth run: resident memory
[MiB], threads, open files, entries of the folder for temporary files. Then as many processes at
once, each with one run. Fails (exit code 1) where a mesh differs by a bit, where run N takes over
1.05 times the memory of run 20 (of run N / 2 where there are fewer than 40), or where threads,
files or temporary folders grow between them.
"""

import argparse
import gc
import hashlib
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import geraf2
from geraf2.surfaces import FitConfig

ONE = "import long_load; print(long_load.one_run(0))"


@dataclass(frozen=True)
class Load:
    """What this process holds."""

    memory_mib: float
    n_threads: int
    n_files: int
    n_temporary: int

    def __str__(self) -> str:
        return (
            f"{self.memory_mib:8.1f} MiB  {self.n_threads:3d} threads  {self.n_files:3d} files  "
            f"{self.n_temporary:3d} temporary"
        )


def measured() -> Load:
    """Load of this process now."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return Load(
        memory_mib=pages * os.sysconf("SC_PAGESIZE") / 2**20,
        n_threads=_count("/proc/self/task"),
        n_files=_count("/proc/self/fd"),
        n_temporary=_count(tempfile.gettempdir()),
    )


def _count(folder: str) -> int:
    return sum(1 for _ in Path(folder).iterdir())


def one_run(number: int) -> str:
    """Reconstruct the small capture -> hash of the content's mesh."""
    config = geraf2.FastPreset(fit=FitConfig(spacing_m=0.01, distance_rounds=1))
    capture, _ = geraf2.examples.small_capture()
    report = number % 10 == 9
    result = geraf2.reconstruct(capture, geraf2.examples.BOX_M, config, report=report)
    data = (result.path / "mesh_content.ply").read_bytes()
    return hashlib.blake2b(data, digest_size=16).hexdigest()


def many_runs(n_runs: int) -> list[str]:
    """Runs one after the other; what was wrong."""
    wrong, first, early = [], "", None
    reference = 20 if n_runs >= 40 else n_runs // 2
    for number in range(1, n_runs + 1):
        digest = one_run(number - 1)
        first = first or digest
        if digest != first:
            wrong.append(f"run {number}: another mesh")
        now = measured() if number % 10 == 0 or number in (1, reference, n_runs) else None
        if now is not None:
            print(f"run {number:4d}  {now}", flush=True)
        if number == reference:
            early = now
    last = measured()
    if early is not None:
        if last.memory_mib > 1.05 * early.memory_mib:
            wrong.append(f"memory grew by {last.memory_mib / early.memory_mib:.3f}")
        names = ("n_threads", "n_files", "n_temporary")
        wrong += [f"{name} grew" for name in names if getattr(last, name) > getattr(early, name)]
        ratio = last.memory_mib / early.memory_mib
        print(f"memory of run {n_runs} over that of run {reference}: {ratio:.3f}")
    return wrong


def many_processes(n_processes: int) -> list[str]:
    """As many processes at once; what was wrong."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", ONE],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=environment,
        )
        for _ in range(n_processes)
    ]
    digests = [process.communicate()[0].strip() for process in processes]
    good = len(set(digests)) == 1 and digests[0]
    print(f"{n_processes} processes at once: {'the same mesh' if good else 'other meshes'}")
    return [] if good else [f"processes differ: {sorted(set(digests))}"]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--processes", type=int, default=8)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:  # of nobody else, so that it can be counted
        os.environ["TMPDIR"] = tempfile.tempdir = scratch
        wrong = many_runs(arguments.runs)
        wrong += many_processes(arguments.processes)
        tempfile.tempdir = None
    for text in wrong:
        print(text)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
