"""`geraf2 doctor`: check of this machine for geraf2."""

import os
import platform
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from geraf2 import __version__
from geraf2.cli._console import keep, rows, say
from geraf2.cli.main import missing_library
from geraf2.errors import UserError

_PACKAGES = (
    "numpy",
    "scipy",
    "torch",
    "zarr",
    "pydantic",
    "rich",
    "trimesh",
    "scikit-image",
    "matplotlib",
)
# Largest relative error of a kernel against the direct sum in float64: the kernels' contract.
_MAX_ERROR = 1e-3


@dataclass(frozen=True, kw_only=True)
class Config:
    """Show versions, CPU, threads and kernels, and run each kernel once."""


def main(config: Config) -> int:
    """Run the command; exit code 2 if something does not work."""
    del config  # no flags
    kernels, threads = _check("kernels use", _simd), _check("threads", _threads)
    checks = [
        _check("matched filter", _check_matched_filter),
        _check("Embree", _check_embree),
        _check("temporary folder", _check_temporary_folder),
    ]
    found = [
        ("geraf2", __version__),
        ("Python", f"{platform.python_version()} ({sys.executable})"),
        ("system", f"{platform.system()} {platform.release()} {platform.machine()}"),
        *((name, _package_version(name)) for name in _PACKAGES),
        ("CPU", _cpu()),
        kernels[:2],
        *(_paths() if kernels[2] else ()),
        threads[:2],
        ("memory", _memory()),
        *((name, text) for name, text, _ in checks),
    ]
    rows(found)
    keep({"rows": {name.strip(): text for name, text in found}})
    faults = [name for name, _, ok in (kernels, threads, *checks) if not ok]
    if faults:
        raise UserError(what=f"{', '.join(faults)} does not work on this machine")
    say("everything works")
    return 0


def _check(name: str, run: Callable[[], str]) -> tuple[str, str, bool]:
    # Whatever is wrong here is what the user wants to read.
    try:
        return name, run(), True
    except Exception as error:
        text = missing_library(error) or f"{type(error).__name__}: {' '.join(str(error).split())}"
        return name, f"FAILS: {text}", False


def _package_version(name: str) -> str:
    """Version of a package, or a note that it is missing."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "MISSING"


def _cpu() -> str:
    """Name of the processor and its instruction sets."""
    names = [
        line.split(":", 1)[1].strip()
        for line in _read("/proc/cpuinfo").splitlines()
        if line.startswith("model name")
    ]
    flags = next((x for x in _read("/proc/cpuinfo").splitlines() if x.startswith("flags")), "")
    known = [flag for flag in ("sse4_2", "avx", "avx2", "fma", "avx512f") if f" {flag}" in flags]
    return f"{names[0] if names else platform.processor() or 'unknown'}; {' '.join(known)}".strip(
        "; "
    )


def _simd() -> str:
    """Instruction set that the kernels use."""
    from geraf2.ops import simd_level  # noqa: PLC0415 - the report must work without it

    requested = os.environ.get("GERAF2_SIMD")
    return simd_level() + (f" (requested by GERAF2_SIMD={requested})" if requested else "")


def _paths() -> list[tuple[str, str]]:
    """Instruction set of each kernel."""
    from geraf2.ops import kernel_paths  # noqa: PLC0415 - as above

    kernels: dict[str, list[str]] = {}
    for kernel, path in kernel_paths().items():
        kernels.setdefault(path, []).append(kernel.replace("_", " "))
    return [(f"  {path}", ", ".join(names)) for path, names in kernels.items()]


def _threads() -> str:
    """Count of OpenMP threads and of CPUs, which are kept for `--json`."""
    from geraf2.ops import max_threads  # noqa: PLC0415 - as above

    n_threads, n_cpus = max_threads(), len(os.sched_getaffinity(0))
    keep({"n_threads": n_threads, "n_cpus": n_cpus})
    return f"{n_threads} by OpenMP, {n_cpus} CPUs to run on"


def _memory() -> str:
    """Free memory and total memory, which are kept for `--json`."""
    kib = {
        line.split(":")[0]: int(line.split()[1])
        for line in _read("/proc/meminfo").splitlines()
        if line.startswith(("MemTotal", "MemAvailable"))
    }
    if len(kib) < 2:
        return "unknown"
    free, total = kib["MemAvailable"], kib["MemTotal"]
    keep({"memory_bytes": 1024 * total, "free_memory_bytes": 1024 * free})
    return f"{free / 2**20:.1f} of {total / 2**20:.1f} GiB free"


def _read(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _check_matched_filter() -> str:
    """Test both kernels against the direct sum on a small problem."""
    from geraf2.constants import SPEED_OF_LIGHT_M_PER_S  # noqa: PLC0415 - as above
    from geraf2.ops import matched_filter  # noqa: PLC0415 - as above
    from geraf2.scene import Grid, Waveform  # noqa: PLC0415 - as above

    waveform = Waveform(
        start_frequency_hz=77e9, chirp_slope_hz_per_s=7e13, sample_rate_hz=1e6, n_samples=32
    )
    rng = np.random.default_rng(0)
    tx = np.array([0.4, 0.0, 0.0]) + rng.uniform(-0.05, 0.05, (40, 3))
    signal = (rng.normal(size=(40, 32)) + 1j * rng.normal(size=(40, 32))).astype(np.complex64)
    grid = Grid.cube((0.0, 0.0, 0.0), 0.02, 9)
    path = 2.0 * np.linalg.norm(grid.points()[:, None] - tx, axis=2)
    phase = 2.0 * np.pi * path[..., None] * waveform.frequencies_hz / SPEED_OF_LIGHT_M_PER_S
    direct = np.einsum("at,vat->v", signal, np.exp(1j * phase)).reshape(grid.shape) / 40
    errors = {}
    for method in ("exact", "block"):
        image = matched_filter(signal, tx, tx, grid, waveform, method=method)
        errors[method] = float(np.linalg.norm(image - direct) / np.linalg.norm(direct))
        if errors[method] > _MAX_ERROR:
            msg = f"{method} kernel is off by {errors[method]:.1e}"
            raise RuntimeError(msg)
    return "works; error " + ", ".join(f"{name} {value:.0e}" for name, value in errors.items())


def _check_embree() -> str:
    """Test the distance to a cube of known size."""
    from geraf2.ops import embree_major  # noqa: PLC0415 - as above
    from geraf2.ops.visibility import MeshScene  # noqa: PLC0415 - as above
    from geraf2.scene import LosPrior  # noqa: PLC0415 - as above

    box = LosPrior.from_box((0.2, 0.2, 0.2))
    distance = MeshScene(box.vertices, box.faces).signed_distance(np.zeros((1, 3)))
    if abs(float(distance[0]) + 0.1) > 1e-6:
        msg = f"the centre of a 0.2 m cube has signed distance {float(distance[0])}"
        raise RuntimeError(msg)
    return f"works; version {embree_major()}"


def _check_temporary_folder() -> str:
    """Test whether a temporary file can be written."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "probe").write_bytes(b"geraf2")
        return f"writable ({Path(folder).parent})"
