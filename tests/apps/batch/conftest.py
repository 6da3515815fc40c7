"""What tests of batches share: one small scan, and how its jobs are run quickly."""

from dataclasses import replace

import pytest

import geraf2
from geraf2.simulation import ScanSpec, simulate


@pytest.fixture(scope="session")
def small_scan():
    """Capture of four coarse planes, and the true mesh."""
    scan = ScanSpec(n_poses=4, spacing_m=0.008, aperture_m=(0.12, 0.12))
    return simulate(replace(geraf2.examples.small_scene(), scan=scan), seed=0)
