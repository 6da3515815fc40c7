"""A scan of a few coarse planes, and its reconstruction as a whole."""

import pytest

import geraf2
from geraf2 import examples
from geraf2.surfaces import FitConfig
from helpers.found_boxes import box_found_once  # noqa: F401 - applies to all tests here


@pytest.fixture(scope="session")
def capture():
    return examples.small_capture()[0]


@pytest.fixture(scope="session")
def whole(capture):
    coarse = geraf2.FastPreset(fit=FitConfig(spacing_m=0.01))
    return geraf2.reconstruct(capture, examples.BOX_M, coarse)
