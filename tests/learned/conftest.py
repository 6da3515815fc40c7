"""A carton with two spheres, seen from four sides."""

import pytest

from carton import carton_capture


@pytest.fixture(scope="package")
def capture():
    return carton_capture(n_poses=4)
