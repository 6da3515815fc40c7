"""Plant bugs in a copy of the kernels, one at a time: tests or sanitizers must report each.

    python tools/planted_bugs.py [--only NAME ...] [--jobs 2]

The copy is compiled with the address and undefined-behaviour sanitizers and must pass as it is.
Fails where a bug is not reported: then a test is missing. Takes some ten minutes.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
COPIED = ("CMakeLists.txt", "CMakePresets.json", "cmake", "cpp")
TESTS = Path("build/sanitize/cpp/tests/geraf2_cpp_tests")
LONGEST_S = 1200.0


@dataclass(frozen=True)
class Bug:
    file: str
    """Below cpp/src."""
    right: str
    """Text that occurs once in the file."""
    wrong: str

    @property
    def kernel(self) -> str:
        return self.file.partition("/")[0]


BUGS = {
    "sign of an adjoint, grid": Bug(
        "sdf_grid/lanes.hpp",
        "const Row<N> along_z = value * wz[0] + slope[2] * wz[1];",
        "const Row<N> along_z = value * wz[0] + -slope[2] * wz[1];",
    ),
    "sign of an adjoint, ray march": Bug(
        "ray_march/lanes.hpp",
        "static_cast<T>(in.power) * later[row] - own[row];",
        "static_cast<T>(in.power) * later[row] + own[row];",
    ),
    "sign of an adjoint, signal tracer": Bug(
        "signal_tracer/lanes.hpp",
        "own -= turned * mirror->factor;",
        "own += turned * mirror->factor;",
    ),
    "off by one, pairs of the matched filter": Bug(
        "matched_filter/exact.hpp",
        "pair_part(signal, first + n_offsets - 1 - j, n_pairs, part);",
        "pair_part(signal, first + n_offsets - j, n_pairs, part);",
    ),
    "off by one, row of a grid": Bug(
        "grid_energy/lanes.hpp", "s[4 * n + k] * middle[k + 2];", "s[4 * n + k] * middle[k + 3];"
    ),
    "off by one, slab of a grid": Bug(
        "sdf_grid/lanes.hpp", "taps.x[a] >= last_x", "taps.x[a] > last_x"
    ),
}


def planted(text: str, bug: Bug) -> str:
    """Text with the bug; ValueError where its position is not unique."""
    if text.count(bug.right) != 1:
        msg = f"{bug.file}: {bug.right!r} occurs {text.count(bug.right)} times, expected once"
        raise ValueError(msg)
    return text.replace(bug.right, bug.wrong)


def build(copy: Path, jobs: int) -> None:
    command = ["cmake", "--build", "--preset", "sanitize", "--target", "geraf2_cpp_tests"]
    command += ["--parallel", str(jobs)]
    done = subprocess.run(command, cwd=copy, capture_output=True, check=False, text=True)
    if done.returncode:
        sys.exit("the copy does not compile:\n" + done.stdout[-2000:])


def reported(copy: Path, kernel: str) -> str:
    """First complaint of a kernel's tests; empty where they pass."""
    done = subprocess.run(
        [copy / TESTS, f"--source-file=*test_{kernel}.cpp"],
        env={**os.environ, "GERAF2_SIMD": "baseline"},
        capture_output=True,
        check=False,
        text=True,
        timeout=LONGEST_S,
    )
    if done.returncode == 0:
        return ""
    lines = (done.stdout + done.stderr).splitlines()
    wanted = ("ERROR", "runtime error", "AddressSanitizer")
    return next((line.strip() for line in lines if any(w in line for w in wanted)), "stopped")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="*", choices=BUGS, default=list(BUGS))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    chosen = parser.parse_args()
    missed = []
    with tempfile.TemporaryDirectory(prefix="planted-") as name:
        copy = Path(name)
        for part in COPIED:
            source = PROJECT / part
            (shutil.copytree if source.is_dir() else shutil.copy)(source, copy / part)
        subprocess.run(["cmake", "--preset", "sanitize"], cwd=copy, check=True, capture_output=True)
        build(copy, chosen.jobs)
        bugs = {title: BUGS[title] for title in chosen.only}
        for kernel in sorted({bug.kernel for bug in bugs.values()}):
            if complaint := reported(copy, kernel):
                print(f"{kernel} without a bug: {complaint}", file=sys.stderr)
                return 1
        for title, bug in bugs.items():
            file = copy / "cpp" / "src" / bug.file
            right = file.read_text(encoding="utf-8")
            file.write_text(planted(right, bug), encoding="utf-8")
            build(copy, chosen.jobs)
            complaint = reported(copy, bug.kernel)
            print(f"{title}: {complaint or 'NOT REPORTED'}", flush=True)
            if not complaint:
                missed.append(title)
            file.write_text(right, encoding="utf-8")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
