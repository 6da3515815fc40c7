"""One plane against a capture by an independent simulator, on the same object and antennas."""

from pathlib import Path

import numpy as np
import pytest

from geraf2.io.mesh import read_mesh
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Wall
from geraf2.simulation.echo import EchoScene, Layer, plane_echo
from geraf2.simulation.elements import mesh_elements
from helpers.antennas import blocks_of
from helpers.synthetic import WAVEFORM

CAPTURE = Path(__file__).parents[3] / "shared" / "data" / "spot_carton"
C = 299792458.0

pytestmark = [
    pytest.mark.data,
    pytest.mark.skipif(not CAPTURE.is_dir(), reason="the shared test captures are not here"),
]


def test_a_plane_without_wall_flash_agrees_with_an_independent_simulator():
    wall = Wall(size_m=(0.22, 0.22, 0.22), thickness_m=0.004, permittivity=1.6)
    mesh = read_mesh(CAPTURE / "truth_object.ply")
    frame = CAPTURE / "mf" / "4_40_0"
    tx, rx, real, imaginary = (
        np.load(frame / f"{name}.npy", allow_pickle=False).astype(np.float64)
        for name in ("tpos", "rpos", "adcr", "adci")
    )
    keep = np.arange(0, len(tx), 16)  # every sixteenth antenna is enough
    signal = (real + 1j * imaginary)[keep]
    offsets = np.append(np.arange(0, len(keep), 6), len(keep))
    antennas = blocks_of(tx[keep], rx[keep], offsets=offsets)
    facets, areas = mesh_elements(mesh.vertices, mesh.faces, 0.0012)
    scene = EchoScene(
        waveform=WAVEFORM,
        walls=(wall,),
        blocker=MeshScene(mesh.vertices, mesh.faces),
        figure=Layer(elements=facets, areas=areas),
    )
    ours = plane_echo(scene, antennas).figure
    correlation = np.vdot(ours, signal) / np.linalg.norm(ours) / np.linalg.norm(signal)
    assert abs(correlation) > 0.9
    window = np.hanning(34)[1:-1]
    ranges = np.arange(0.36, 0.46, 0.01)
    bank = np.exp(2j * np.pi * np.outer(2 * ranges + 0.15, WAVEFORM.frequencies_hz) / C) * window
    profiles = [np.mean(np.abs(s @ bank.T) ** 2, axis=0) for s in (ours, signal)]
    shape_db = 10 * np.log10(profiles[0] / profiles[1])
    assert np.ptp(shape_db) < 2.5
