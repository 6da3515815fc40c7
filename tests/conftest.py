"""Fixtures for all tests, and a header that says what this machine can run."""

import os
import shutil
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

# As the command line does, and before anything loads NumPy: BLAS threads that wait for each other
# make small matrix products ten times slower.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# The workers of pytest-xdist share the cores; tests of threads name their number themselves.
if (workers := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))) > 1:
    os.environ.setdefault("OMP_NUM_THREADS", str(max(1, (os.cpu_count() or 1) // workers)))

PROJECT = Path(__file__).resolve().parent.parent
SHARED_DATA = PROJECT.parent / "shared" / "data"


def _installed(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "absent"


def _native() -> str:
    try:
        from geraf2 import _core  # noqa: PLC0415, TID251 - the header reports its absence
    except ImportError as error:
        return f"native module absent ({error})"
    return f"Embree {_core.embree_major()}, SIMD {_core.simd_level()}"


def pytest_report_header() -> list[str]:
    data = "present" if SHARED_DATA.is_dir() else "absent, tests marked `data` are skipped"
    names = ("chromium", "chromium-browser", "google-chrome")
    browser = next((name for name in names if shutil.which(name)), "absent")
    return [
        f"geraf2: {_native()}, torch {_installed('torch')}, numpy {_installed('numpy')}",
        f"geraf2: browser {browser}, playwright {_installed('playwright')}",
        f"geraf2: shared captures {data}",
    ]


@pytest.fixture(scope="session")
def project_root() -> Path:
    """The folder of a source checkout; skips where only the package is installed."""
    if not (PROJECT / "pyproject.toml").is_file():
        pytest.skip("needs the source tree")
    return PROJECT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the shared test captures; skips where they are absent."""
    if not SHARED_DATA.is_dir():
        pytest.skip("../shared/data is absent; the captures there are not part of the project")
    return SHARED_DATA
