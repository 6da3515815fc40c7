"""`geraf2 doctor`: check of this machine for geraf2."""

import platform
import sys
from collections.abc import Callable
from dataclasses import dataclass

from geraf2 import __version__
from geraf2.cli._console import rows, say
from geraf2.cli.main import missing_library
from geraf2.errors import UserError
from geraf2.pipeline import machine

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


@dataclass(frozen=True, kw_only=True)
class Config:
    """Show versions, CPU, threads and kernels, and run each kernel once."""


def main(config: Config) -> int:
    """Run the command; exit code 2 if something does not work."""
    del config  # no flags
    kernels, threads = _check("kernels use", machine.simd), _check("threads", machine.threads)
    checks = [
        _check("matched filter", machine.check_matched_filter),
        _check("Embree", machine.check_embree),
        _check("temporary folder", machine.check_temporary_folder),
    ]
    rows(
        [
            ("geraf2", __version__),
            ("Python", f"{platform.python_version()} ({sys.executable})"),
            ("system", f"{platform.system()} {platform.release()} {platform.machine()}"),
            *((name, machine.package_version(name)) for name in _PACKAGES),
            ("CPU", machine.cpu()),
            kernels[:2],
            *(machine.paths() if kernels[2] else ()),
            threads[:2],
            ("memory", machine.memory()),
            *((name, text) for name, text, _ in checks),
        ]
    )
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
