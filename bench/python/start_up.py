"""Time that `geraf2 --help` and `import geraf2` take, each in a process of its own.

    python bench/python/start_up.py [--runs 10] [--check]

Prints the medians of wall and CPU time, with those of Python alone beside them. --check fails
where one takes more CPU time than it may: 0.25 s for the help, 0.15 s for the import. CPU time is
compared, because other programs on the same cores do not lengthen it.
"""

import argparse
import resource
import subprocess
import sys
import time
from statistics import median

CASES = {
    "python": ([sys.executable, "-c", "pass"], None),
    "import geraf2": ([sys.executable, "-c", "import geraf2"], 0.15),
    "geraf2 --help": (
        [sys.executable, "-c", "from geraf2.cli.main import main; main(['--help'])"],
        0.25,
    ),
}
"""Command and its limit of CPU time [s]."""


def seconds(command: list[str]) -> tuple[float, float]:
    """Wall and CPU time of one process [s]."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    is_slow = False
    for name, (command, limit) in CASES.items():
        seconds(command)  # reads the files from the disk, writes their byte code
        walls, cpus = zip(*(seconds(command) for _ in range(options.runs)), strict=True)
        allowed = "" if limit is None else f", at most {limit:g} s of CPU"
        print(f"{name:<14} {median(walls):.3f} s, CPU {median(cpus):.3f} s{allowed}")
        is_slow = is_slow or (limit is not None and median(cpus) > limit)
    return 1 if options.check and is_slow else 0


if __name__ == "__main__":
    sys.exit(main())
