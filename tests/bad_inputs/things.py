"""Good inputs of every command, made once, which the rows of the table spoil."""

import json
import shutil
from pathlib import Path

import numpy as np
from scipy.io import savemat

import geraf2
from geraf2.geometry.boxes import FACES, box_corners
from geraf2.io.mesh import TriangleMesh, write_mesh
from geraf2.surfaces import FitConfig
from helpers.planar_scan import write_planar
from helpers.raw_capture import (
    BOARD_RX,
    RADAR_TOML,
    STUDIO,
    raster_positions,
    scan_signal,
    words_of,
)
from helpers.scene_photos import write_colmap
from helpers.synthetic import WAVEFORM, point_capture, write_geraf_sens

BOX = (0.16, 0.16, 0.16)
SPEC = """
[figure]
name = "llama"
height_m = 0.06
[waveform]
start_frequency_hz = 77e9
[scan]
n_poses = 4
spacing_m = 0.008
aperture_m = [0.12, 0.12]
[numerics]
wall_patch_m = 0.02
antenna_block_m = 0.07
[world]
preset = "none"
[[walls]]
size_m = [0.16, 0.16, 0.16]
thickness_m = 0.004
permittivity = 1.6
"""


def make_things(root):
    """Fill a folder; every entry is what a row may name first in a path."""
    make_foreign(root)
    _scene_and_run(root)
    (root / "empty").mkdir()
    (root / "other").mkdir()
    (root / "other" / "diary.txt").write_text("kept")


def make_foreign(root):
    """Captures, photos, meshes and settings as other programs write them."""
    box = TriangleMesh(vertices=box_corners((0.0, 0.0, 0.0), BOX), faces=FACES.copy())
    write_mesh(box, root / "box.ply")
    (root / "spec.toml").write_text(SPEC)
    capture = point_capture(3)
    write_geraf_sens(root / "frames", capture)
    (root / "raw").mkdir()
    signal = scan_signal(raster_positions(6, 6, 0.004))
    (root / "raw" / "adc.bin").write_bytes(words_of(signal).tobytes())
    board = f"[antennas]\nrx_offsets_m = {BOARD_RX.tolist()}\n"
    (root / "radar.toml").write_text(RADAR_TOML + "[raw]\nframe_period_s = 0.01\n" + board)
    studio = json.dumps(STUDIO).replace('"numFrames": 20', '"numFrames": 36')
    studio = studio.replace('"numLoops": 2', '"numLoops": 1')  # a chirp is a position
    (root / "studio.mmwave.json").write_text(studio)
    times = 0.01 * np.arange(40)
    positions = np.column_stack([times, 0 * times, 0.01 * times, 0 * times])
    text = "\n".join(",".join(f"{v:.6g}" for v in row) for row in positions)
    (root / "robot.csv").write_text(f"time_s,x_m,y_m,z_m\n{text}\n")
    stack = {
        name: np.stack([getattr(pose, name) for pose in capture.poses])
        for name in ("signal", "tx_positions", "rx_positions", "axes")
    }
    names = ("start_frequency_hz", "chirp_slope_hz_per_s", "sample_rate_hz", "path_bias_m")
    savemat(root / "scan.mat", stack | {name: getattr(WAVEFORM, name) for name in names})
    pose = capture.poses[0]
    np.savez(
        root / "norm.npz",
        received_signals=pose.signal.reshape(-1, 1, 32).transpose(0, 2, 1).repeat(4, axis=2),
        antenna_locations=pose.tx_positions[:, [1, 2, 0]] * [1, 1, 0],
    )
    write_planar(root / "planar")
    write_colmap(root / "colmap", binary=True)
    write_colmap(root / "colmap_text", binary=False)
    _nerf(root)


def _scene_and_run(root):
    capture, truth = geraf2.simulate(geraf2.load_spec(root / "spec.toml"), seed=0)
    geraf2.save_capture(capture, root / "scene")
    write_mesh(truth, root / "truth.ply")
    preset = geraf2.FastPreset(fit=FitConfig(spacing_m=0.012))
    options = geraf2.RunOptions(calibrate="no")
    geraf2.reconstruct(root / "scene", BOX, preset, root / "run", options=options)


def _nerf(root):
    """Photos with transforms.json, as nerfstudio's."""
    cameras = write_colmap(root / "nerf", binary=True)
    frames = []
    for index, camera in enumerate(cameras):
        pose = camera.camera_to_world.copy()
        pose[:3, 1:3] *= -1.0
        frames.append({"file_path": f"images/photo{index}.png", "transform_matrix": pose.tolist()})
    lens = {"fl_x": 60.0, "fl_y": 60.0, "cx": 32.5, "cy": 24.5, "w": 64, "h": 48}
    (root / "nerf" / "transforms.json").write_text(json.dumps(lens | {"frames": frames}))
    shutil.rmtree(root / "nerf" / "sparse")


def named(texts, root):
    """Entries of `root` that are named in some texts."""
    words = {part for text in texts for part in text.replace("=", " ").split()}
    first = {Path(word).parts[0] for word in words if (root / word).parts}
    return sorted(first & {entry.name for entry in root.iterdir()})
