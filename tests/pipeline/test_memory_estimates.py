"""Estimates of memory against the peak of real processes, which --max-memory is compared with."""

import re
import subprocess
import sys
from contextlib import nullcontext

import numpy as np
import pytest

import geraf2
from geraf2._memory import memory_limit
from geraf2.errors import UserError
from geraf2.pipeline.estimates import image_estimate, reconstruct_cost, require_reconstructable
from geraf2.pipeline.presets import BestPreset, FastPreset
from geraf2.scene.summary import summarize_capture
from geraf2.surfaces import FitConfig
from geraf2.surfaces.fit import _domain
from geraf2.surfaces.fit_memory import fit_bytes
from geraf2.surfaces.refinement import RefineConfig
from helpers.synthetic import point_capture

MIB = 2.0**20


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_the_estimate_of_an_image_is_near_its_peak(tmp_path):
    capture = point_capture(2)
    geraf2.save_capture(capture, tmp_path / "scene")
    words = ["image", "scene", "out", "--size-m", "0.1", "0.1", "0.1", "--spacing-m", "0.001"]
    # Of the process itself: `ru_maxrss` counts what its parent had when it forked, too.
    code = (
        f"from geraf2.cli.main import main; assert main({words}) == 0; "
        "print(open('/proc/self/status').read())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    peak = 1024.0 * int(re.search(r"VmHWM:\s+(\d+) kB", done.stdout)[1])
    estimate = image_estimate(summarize_capture(capture), 101**3).memory_bytes
    assert peak / 1.3 < estimate < 1.3 * peak


def test_memory_depends_on_voxels_and_samples():
    summary = summarize_capture(point_capture(2))
    box = (0.2, 0.2, 0.2)
    assert reconstruct_cost(9_000_000).memory_bytes > 550 * MIB
    fine = FitConfig(spacing_m=0.001, max_voxels=10**9)
    with memory_limit(500 * MIB):
        for preset in (FastPreset(), BestPreset()):
            require_reconstructable(summary, preset, box, "scene")
        for preset in (FastPreset(fit=fine), BestPreset(refine=RefineConfig(fit=fine))):
            with pytest.raises(UserError, match="scene: the run will not fit into memory"):
                require_reconstructable(summary, preset, box, "scene")
        with pytest.raises(UserError, match="the run will not fit into memory"):
            require_reconstructable(summary, FastPreset(), (0.7, 0.05, 0.05), "scene")
        capped = FitConfig(spacing_m=0.001, max_voxels=10**6)
        require_reconstructable(summary, FastPreset(fit=capped), box, "scene")


def test_a_fit_is_refused_where_its_own_grid_exceeds_the_limit():
    """A box may be larger than its content, or the prior unknown before the run."""
    corners = np.array([[-0.05, -0.05, -0.05], [0.05, 0.05, 0.05]])
    config = FitConfig(spacing_m=0.002)
    n_voxels = _domain(corners, config).n_voxels
    for allowed, refused in ((1.1 * fit_bytes(n_voxels), False), (0.8 * fit_bytes(n_voxels), True)):
        with memory_limit(allowed), pytest.raises(UserError) if refused else nullcontext():
            _domain(corners, config)
