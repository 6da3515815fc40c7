"""Estimated and measured memory of each command at three sizes.

    python bench/python/memory.py [--commands image best ...] [--sizes 0 1 2] [--check]

Every command runs in a process of its own on simulated scenes of 2, 6 and 12 planes; grids
have voxels of 4, 2 and 1 mm, and recordings 20, 60 and 120 MB. The estimate is the largest that the
command itself compares with --max-memory; the peak is the largest resident set of the process
(VmHWM). --check fails where both differ by more than a factor of 1.3 and the peak is above 400 MiB:
commands that always take less need no estimate. Wants Linux.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from import_raw import PARAMETERS, write_recording
from reconstruct import SMALL_SPEC, geraf2_command

MIB = 2.0**20
WITHIN = 1.3
SMALL_BYTES = 400 * MIB
"""Peak from which on a command needs an estimate."""
SIZES = ((2, 0.006, 0.004, 20), (6, 0.004, 0.002, 60), (12, 0.004, 0.001, 120))
"""Planes, spacing of their antennas and of voxels [m], size of the recording [MB]."""
BOX = ("--box", "0.2", "0.2", "0.2")
CHILD = """
import json, sys
from geraf2 import _memory
needs, require = [0.0], _memory.require_memory
def noted(needed_bytes, hint, *, where=None):
    needs.append(needed_bytes)
    require(needed_bytes, hint, where=where)
_memory.require_memory = noted
from geraf2.cli.main import main
code = main(sys.argv[1:])
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print()
print(json.dumps([code, max(needs), 1024.0 * float(status["VmHWM"].split()[0])]))
"""


def measured(*words: str, allowed: tuple[int, ...] = (0,)) -> tuple[float, float]:
    """Estimate and peak of a command [bytes]."""
    command = [sys.executable, "-c", CHILD, *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = done.stdout.splitlines()
    code, estimate, peak = json.loads(lines[-1]) if lines else (-1, 0.0, 0.0)
    if code not in allowed:
        sys.exit(f"geraf2 {' '.join(words)}: exit code {code}\n{done.stderr.strip()}")
    return estimate, peak


def cases(folder: Path, size: int) -> dict[str, tuple[str, ...]]:
    """Words of each command in a folder, in their order: later ones use what earlier ones wrote."""
    n_poses, antennas_m, voxels_m, size_mb = SIZES[size]
    (folder / "spec.toml").write_text(
        SMALL_SPEC.format(n_poses=n_poses, spacing_m=antennas_m, aperture_m=[0.16, 0.16])
    )
    n_chirps = write_recording(folder / "raw.bin", "4-lane", size_mb, size_mb)
    radar = "".join(f"{key} = {value}\n" for key, value in PARAMETERS.items())
    (folder / "radar.toml").write_text(radar)
    raw = [str(folder / name) for name in ("raw.bin", "imported", "radar.toml")]
    scene, fast, best = (str(folder / name) for name in ("scene", "fast", "best"))
    voxels, fit = ("--spacing-m", str(voxels_m)), ("--fit.spacing-m", str(voxels_m))
    truth = str(folder / "scene" / "truth.ply")
    return {
        "simulate": ("simulate", str(folder / "spec.toml"), scene),
        "image": ("image", scene, str(folder / "image"), "--size-m", *BOX[1:], *voxels),
        "fast": ("reconstruct", scene, fast, *BOX, "--preset", "fast", *fit),
        "best": ("reconstruct", scene, best, *BOX, "--refine.fit.spacing-m", str(voxels_m)),
        "evaluate": ("evaluate", fast, "--truth", truth),
        "los": ("los", scene, str(folder / "los")),
        "inspect": ("inspect", fast, "--cad", truth, "--unit", "m"),
        "import": (
            *("import", "dca1000", *raw[:2], "--radar", raw[2]),
            *("--raster", str(n_chirps // 1024), "1024", "1e-3", "1e-3"),
        ),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--commands", nargs="+")
    parser.add_argument("--sizes", nargs="+", type=int, default=range(len(SIZES)))
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    is_off = False
    print(f"{'command':<10} {'planes':>6}  {'estimate':>8}  {'peak':>8}  ratio  [MiB]", flush=True)
    for size in options.sizes:
        with tempfile.TemporaryDirectory() as folder:
            for name, words in cases(Path(folder), size).items():
                if options.commands and name not in options.commands:
                    subprocess.run([*geraf2_command(), *words], capture_output=True, check=False)
                    continue
                estimate, peak = measured(*words, allowed=(0, 3))
                ratio = estimate / peak
                is_off |= not 1 / WITHIN <= ratio <= WITHIN and peak > SMALL_BYTES
                print(
                    f"{name:<10} {SIZES[size][0]:>6}  {estimate / MIB:>8.0f}  {peak / MIB:>8.0f}  "
                    f"{ratio:>5.2f}",
                    flush=True,
                )
    return 1 if options.check and is_off else 0


if __name__ == "__main__":
    sys.exit(main())
