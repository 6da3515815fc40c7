"""Fixtures for all tests, and a header with what this machine can run."""

import os
import shutil
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

from helpers.browsing import DESKTOP, FLAGS, PHONE, settle

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


@pytest.fixture(scope="module")
def browser():
    """Chromium; skips where it is absent."""
    names = ("chromium", "chromium-browser", "google-chrome")
    found = next((path for name in names if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip("no Chromium: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="pip install playwright")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=found, args=list(FLAGS))
        yield browser
        browser.close()


@pytest.fixture
def open_page(browser):
    """Open a page: (url, size, dark) -> page, with what it complained of and asked for."""
    contexts = []

    def opened(url, size=DESKTOP, dark=False, without_webgl=False):
        context = browser.new_context(
            viewport={"width": size[0], "height": size[1]},
            color_scheme="dark" if dark else "light",
            has_touch=size == PHONE,
            reduced_motion="reduce",
        )
        contexts.append(context)
        page = context.new_page()
        page.trouble, page.requests = [], []
        page.on("console", lambda message: page.trouble.append(message.text))
        page.on("pageerror", lambda error: page.trouble.append(str(error)))
        page.on("request", lambda request: page.requests.append(request.url))
        if without_webgl:
            page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
        page.goto(url)
        settle(page)
        return page

    yield opened
    for context in contexts:
        context.close()


@pytest.fixture(scope="module")
def axe(request):
    """Source of axe-core, which is no part of the project."""
    folder = request.config.cache.mkdir("axe")
    source = folder / "node_modules" / "axe-core" / "axe.min.js"
    if not source.is_file():
        npm = shutil.which("npm")
        if npm is None:
            pytest.skip("npm is absent: it installs axe-core")
        command = [
            npm,
            "install",
            "--silent",
            "--ignore-scripts",
            "--prefix",
            str(folder),
            "axe-core@4",
        ]
        try:
            subprocess.run(command, check=True, timeout=60, capture_output=True, env=os.environ)
        except (subprocess.SubprocessError, OSError):
            pytest.skip("npm could not install axe-core")
    return source.read_text(encoding="utf-8")
