"""Readers of files from strangers, each as a function of one file's bytes.

A reader may return or raise UserError; whatever else it raises is a finding. Where a format has
several files, the first byte of the data selects which of them the rest is, and the others are
good ones.
"""

import shutil
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from bad_inputs.things import make_foreign
from geraf2.apps.importers import ImportOptions
from geraf2.apps.importers import load_importer as _load_importer
from geraf2.apps.importers._robot_log import read_log
from geraf2.apps.importers._ti_config import read_ti_configs
from geraf2.apps.photos.photo_store import load_photos
from geraf2.io.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from geraf2.io.container import SceneReader
from geraf2.io.manifest import RadarManifest
from geraf2.io.mesh import read_mesh, write_mesh
from geraf2.io.run_folder import RunFolder
from geraf2.io.toml import read_toml
from geraf2.io.transform_file import read_transform
from geraf2.pipeline.run_record import RunRecord
from geraf2.scene.checks import check_capture
from geraf2.scene.store import capture_without_poses, save_capture
from geraf2.scene.summary import summarize_poses
from geraf2.simulation import load_spec
from helpers.raw_capture import PROFILE
from helpers.run_folders import record_run
from helpers.synthetic import point_capture

load_importer = cache(_load_importer)  # which looks through all installed packages

_FRAME = ("tpos.npy", "rpos.npy", "adcr.npy", "adci.npy", "rotation.npy")
_SIGNAL = "radar.zarr/signal/"


@cache
def _good():
    """Folder with good examples, a folder a reader, made once."""
    root = Path(tempfile.mkdtemp(prefix="readers-"))
    make_foreign(root)
    save_capture(point_capture(2, n_side=3), root / "scene")
    for name in ("mat", "mmnorm", "ti", "robot", "mesh", "safetensors", "transform", "toml", "run"):
        (root / name).mkdir()
    for name, file in (
        ("mat", "scan.mat"),
        ("mmnorm", "norm.npz"),
        ("ti", "studio.mmwave.json"),
        ("robot", "robot.csv"),
        ("mesh", "box.ply"),
        ("toml", "spec.toml"),
        ("toml", "radar.toml"),
    ):
        shutil.copyfile(root / file, root / name / file)
    box = read_mesh(root / "mesh" / "box.ply")
    write_mesh(box, root / "mesh" / "a.glb")
    (root / "mesh" / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (root / "mesh" / "a.stl").write_bytes(bytes(80) + b"\1\0\0\0" + bytes(50))
    (root / "mesh" / "a.gltf").write_text('{"asset": {"version": "2.0"}, "meshes": []}')
    (root / "ti" / "a.cfg").write_text(PROFILE)
    (root / "ti" / "a_LogFile.txt").write_text("API:ProfileConfig,0,1,7,6,60,0,0,9,0,64,1000,0\n")
    (root / "ti" / "a.lua").write_text("ar1.FrameConfig(0, 1, 20, 1, 50, 0, 0, 1)\n")
    (root / "ti" / "cf.json").write_text('{"DCA1000Config": {"dataFormatMode": 3}}')
    (root / "transform" / "a.txt").write_text("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    (root / "transform" / "a.json").write_text("[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]")
    np.save(root / "transform" / "a.npy", np.eye(4))
    arrays = {"a": np.arange(6.0), "b": np.zeros((2, 2), np.float32)}
    checkpoint = Checkpoint(kind="paper", version=1, arrays=arrays, header={"step": 3})
    save_checkpoint(root / "safetensors" / "a.safetensors", checkpoint)
    RunRecord().write(root / "toml" / "config.toml")
    record_run(root / "run")
    return root


def clean_up():
    """Remove the examples."""
    if _good.cache_info().currsize:
        shutil.rmtree(_good(), ignore_errors=True)
        _good.cache_clear()


def read(name, data):
    """Read data as the file of the reader `name` that its first byte selects."""
    parts = PARTS[name]
    part = parts[data[0] % len(parts)] if data else parts[0]
    folder = _good() / name
    file = folder / part
    file.parent.mkdir(parents=True, exist_ok=True)
    before = file.read_bytes() if file.exists() else None
    file.write_bytes(data[1:])
    try:
        READERS[name][0](folder, file)
    finally:
        if before is None:
            file.unlink()
        else:
            file.write_bytes(before)


def seeds(name):
    """Good data for a reader: each of its files that there is an example of."""
    for number, part in enumerate(PARTS[name]):
        file = _good() / name / part
        if file.exists():
            yield bytes([number]) + file.read_bytes()


def _scene(folder, _):
    reader = SceneReader(folder)
    base = capture_without_poses(reader.manifest)
    poses = (reader.read_pose(index) for index in range(reader.n_poses))
    check_capture(summarize_poses(poses, base.waveform, base.walls))


def _import(format_name, **radar):
    def run(folder, file):
        source = file if format_name in ("mat", "mmnorm", "dca1000") else folder
        for keep_good in (False, True):
            options = ImportOptions(keep_good=keep_good, static=format_name == "dca1000")
            scan = load_importer(format_name).open(source, RadarManifest(**radar), options)
            for _ in scan.poses():
                pass

    return run


def _toml(folder, file):
    if file.name == "spec.toml":
        load_spec(file)
    elif file.name == "radar.toml":
        read_toml(file, RadarManifest)
    else:
        RunRecord.read(file)


_CHIRP = {"start_frequency_hz": 77e9, "chirp_slope_hz_per_s": 60e12, "sample_rate_hz": 1e6}


def _photos(folder, _):
    load_photos(folder)


READERS = {
    "scene": (
        _scene,
        "scene.toml",
        "radar.zarr/zarr.json",
        _SIGNAL + "zarr.json",
        _SIGNAL + "c/0/0/0",
        "radar.zarr/axes/zarr.json",
        "radar.zarr/antenna_count/c/0",
        "radar.zarr/angle/zarr.json",
        "radar.zarr/tx_positions/c/1/0/0",
    ),
    "frames": (_import("geraf-sens"), *(f"mf/1_120_0/{name}" for name in _FRAME), "capture.json"),
    "mat": (_import("mat"), "scan.mat"),
    "mmnorm": (_import("mmnorm"), "norm.npz"),
    "planar": (_import("planar"), "scan.npy", "antenna_phase.txt"),
    "raw": (_import("dca1000", **_CHIRP), "adc.bin"),
    "ti": (
        lambda folder, file: read_ti_configs([file]),
        *("studio.mmwave.json", "cf.json", "a.cfg", "a_LogFile.txt", "a.lua"),
    ),
    "robot": (
        lambda folder, file: read_log(file, keep_good=bool(file.stat().st_size % 2)),
        *("robot.csv", "robot.npy"),
    ),
    "mesh": (
        lambda folder, file: read_mesh(file),
        *("box.ply", "a.obj", "a.stl", "a.glb", "a.gltf"),
    ),
    "colmap": (_photos, "sparse/0/cameras.bin", "sparse/0/images.bin"),
    "colmap_text": (_photos, "sparse/0/cameras.txt", "sparse/0/images.txt"),
    "nerf": (_photos, "transforms.json", "images/photo0.png"),
    "safetensors": (
        lambda folder, file: load_checkpoint(file, kind="paper", version=1),
        "a.safetensors",
    ),
    "transform": (lambda folder, file: read_transform(file), "a.txt", "a.json", "a.npy"),
    "toml": (_toml, "spec.toml", "radar.toml", "config.toml"),
    "run": (lambda folder, file: RunFolder.read(folder), "run.json"),
}
PARTS = {name: parts for name, (_, *parts) in READERS.items()}
"""Of each reader, the files that data may stand for."""
