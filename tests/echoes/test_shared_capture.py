"""The delay of a whole capture of an independent simulator; its scores: tests/cli."""

from dataclasses import replace

import numpy as np
import pytest

from geraf2.apps.importers import load_importer
from geraf2.io.manifest import RadarManifest
from geraf2.io.mesh import read_mesh
from geraf2.io.samples import complex_pose
from geraf2.scene import LosPrior
from geraf2.scene.store import capture_without_poses
from helpers.carton import aligned


@pytest.mark.data
def test_an_unknown_delay_is_found_to_a_millimetre_of_path(shared_data):
    source = shared_data / "spot_carton"
    if not source.is_dir():
        pytest.skip("spot_carton is absent from the shared captures")
    scan = load_importer("geraf-sens").open(source, RadarManifest())
    about = capture_without_poses(scan.manifest)
    blind = replace(
        about,
        poses=tuple(complex_pose(pose) for pose in scan.poses()),
        waveform=replace(about.waveform, path_bias_m=0.0),
        provenance={},  # which says that it was recorded
    )
    found = aligned(blind, LosPrior.from_mesh(read_mesh(source / "los_box.ply")))
    assert found.delay_m == pytest.approx(0.15, abs=1e-3)
    assert abs(found.delay_m - 0.15) < 2.0 * found.delay_sigma_m
    assert np.rad2deg(np.abs(found.rotation_rad).max()) < 0.2
    assert np.abs(found.translation_m).max() < 5e-4
