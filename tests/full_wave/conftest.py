"""Modules of bench/full_wave, by their names."""

import importlib
import sys
from types import SimpleNamespace

import pytest

from helpers.found_boxes import box_found_once  # noqa: F401 - applies to all tests here

_NAMES = (
    "waves",
    "body",
    "echo",
    "meridian",
    "cluster",
    "box",
    "mirror",
    "bodies",
    "captures",
    "comparison",
)


@pytest.fixture(scope="session")
def wave(project_root):
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(project_root / "bench" / "full_wave"))
        yield SimpleNamespace(**{name: importlib.import_module(name) for name in _NAMES})
        for name in _NAMES:
            sys.modules.pop(name, None)
