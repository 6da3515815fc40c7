"""Wall time, CPU time and peak memory of `geraf2 reconstruct` as a process of its own.

    python bench/python/reconstruct.py SCENE [--repeats 3] [--json FILE] [-- --box 0.22 0.22 0.22]

What follows `--` goes to `geraf2 reconstruct`. Every repeat writes into a new folder, so that
nothing is cached; medians are reported, with the range beside them. Memory is the largest resident
set that the kernel saw for the process, Python and all libraries included. The stages are as the
run's own record has them; "other" is the rest of the process: start-up, reading, checks.
"""

import argparse
import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

KIB = 1024
SMALL_SPEC = """
[figure]
name = "llama"
height_m = 0.11
[[walls]]
size_m = [0.20, 0.20, 0.20]
[scan]
n_poses = {n_poses}
spacing_m = {spacing_m}
aperture_m = {aperture_m}
[numerics]
wall_patch_m = 0.02
antenna_block_m = 0.07
"""


@dataclass(frozen=True, kw_only=True)
class Measurement:
    wall_s: float
    cpu_s: float
    peak_memory_mib: float


def read_stages(run: Path) -> dict[str, tuple[float, float]]:
    """Wall and CPU seconds of each stage, from the run's record."""
    stages = json.loads((run / "run.json").read_text(encoding="utf-8"))["stages"]
    return {name: (s["seconds"], s["cpu_seconds"]) for name, s in stages.items()}


def geraf2_command() -> list[str]:
    """The geraf2 beside this interpreter, so that the environment is the measured one."""
    beside = Path(sys.executable).with_name("geraf2")
    found = str(beside) if beside.is_file() else shutil.which("geraf2")
    if found is None:
        sys.exit("no geraf2 command beside this Python or on the path; run `make setup`")
    return [found]


def measure(command: list[str], *, quiet: bool = False) -> Measurement:
    start = time.perf_counter()
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL if quiet else None
    )
    # wait4 hands back the resources of this very child; getrusage(RUSAGE_CHILDREN) would give the
    # largest of all repeats so far.
    _, status, usage = os.wait4(process.pid, 0)
    wall_s = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        sys.exit(f"{' '.join(command)}: exit code {process.returncode}")
    return Measurement(
        wall_s=wall_s,
        cpu_s=usage.ru_utime + usage.ru_stime,
        peak_memory_mib=usage.ru_maxrss / KIB,  # Linux counts it in KiB
    )


def with_stages(total: Measurement, run: Path) -> dict[str, float]:
    """One repeat as a row: the whole, then wall and CPU seconds of each stage and of the rest."""
    stages = read_stages(run)
    stages["other"] = (
        total.wall_s - sum(wall for wall, _ in stages.values()),
        total.cpu_s - sum(cpu for _, cpu in stages.values()),
    )
    row = asdict(total)
    for name, (wall_s, cpu_s) in stages.items():
        row |= {f"{name}_wall_s": wall_s, f"{name}_cpu_s": cpu_s}
    return row


def summarise(rows: list[dict[str, float]]) -> dict[str, dict[str, float]]:
    columns = {key: [row[key] for row in rows] for key in rows[0]}
    return {
        key: {"median": statistics.median(values), "min": min(values), "max": max(values)}
        for key, values in columns.items()
    }


def parse_arguments(arguments: list[str]) -> tuple[argparse.Namespace, list[str]]:
    split = arguments.index("--") if "--" in arguments else len(arguments)
    ours, passed_on = arguments[:split], arguments[split + 1 :]
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path, help="also write the result here")
    return parser.parse_args(ours), passed_on


def main() -> None:
    options, passed_on = parse_arguments(sys.argv[1:])
    rows = []
    for _ in range(options.repeats):
        with tempfile.TemporaryDirectory(prefix="geraf2-bench-") as scratch:
            out = Path(scratch) / "out"
            command = [*geraf2_command(), "reconstruct", str(options.scene), str(out), *passed_on]
            rows.append(with_stages(measure(command), out))
    summary = summarise(rows)
    for key, values in summary.items():
        spread = f"{values['min']:.2f} .. {values['max']:.2f}"
        print(f"{key:16} {values['median']:10.2f}   ({spread}, {options.repeats} runs)")
    if options.json is not None:
        record = {
            "what": "geraf2 reconstruct",
            "scene": options.scene.name,
            "arguments": passed_on,
            "cpus": os.cpu_count(),
            "machine": platform.machine(),
            "python": platform.python_version(),
            "repeats": options.repeats,
            **summary,
        }
        options.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
