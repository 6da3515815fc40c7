"""Files that are not what their names state are recognised by every reader."""

import bz2
import gzip
import io
import lzma
import tarfile
import zipfile

import numpy as np
import pytest

from geraf2.apps.importers import ImportOptions, load_importer
from geraf2.apps.importers._robot_log import read_log
from geraf2.apps.importers._ti_config import read_ti_configs
from geraf2.apps.photos.formats.colmap import read_colmap
from geraf2.apps.photos.formats.images import read_image
from geraf2.cli.main import main
from geraf2.errors import UserError
from geraf2.io.arrays import read_npy, read_npz
from geraf2.io.checkpoint import load_checkpoint
from geraf2.io.file_kinds import refuse_other_kind
from geraf2.io.manifest import RadarManifest
from geraf2.io.mesh import read_mesh
from geraf2.io.toml import read_table
from geraf2.io.transform_file import read_transform

POINTER = b"""version https://git-lfs.github.com/spec/v1
oid sha256:0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef
size 61440000
"""
PAGE = b"\n<!DOCTYPE html>\n<html><body>404: Not Found</body></html>\n"
BODY = bytes(range(256)) * 40


def archive(name):
    file = io.BytesIO()
    if name == "zip":
        with zipfile.ZipFile(file, "w") as zipped:
            zipped.writestr("a", BODY)
    else:
        with tarfile.open(fileobj=file, mode="w") as tar:
            tar.addfile(tarfile.TarInfo("a"))
    return file.getvalue()


KINDS = {
    "LFS pointer: git lfs pull": POINTER,
    "git-annex": b"/annex/objects/MD5E-s1--d41d8cd98f.bin\n",
    "web page": PAGE,
    "error message": b'<?xml version="1.0"?>\n<Error><Code>AccessDenied</Code></Error>',
    "gzip": gzip.compress(BODY),
    "ZIP": archive("zip"),
    "bzip2": bz2.compress(BODY),
    "xz": lzma.compress(BODY),
    "tar archive": archive("tar"),
    "7z": b"7z\xbc\xaf\x27\x1c" + BODY,
    "pcap": b"\xd4\xc3\xb2\xa1" + BODY,
    "ROS bag": b"#ROSBAG V2.0\n" + BODY,
    "PDF": b"%PDF-1.7\n" + BODY,
}


def imported(name, **options):
    def read(path):
        return load_importer(name).open(path, RadarManifest(), ImportOptions(**options))

    return read


READERS = {
    "capture.bin": imported("dca1000"),
    "scan.mat": imported("mat"),
    "scan.npy": imported("planar"),
    "scan.npz": imported("mmnorm"),
    "log.csv": lambda path: read_log(path, keep_good=False),
    "log.npy": lambda path: read_log(path, keep_good=False),
    "studio.mmwave.json": lambda path: read_ti_configs([path]),
    "profile.cfg": lambda path: read_ti_configs([path]),
    "part.stl": read_mesh,
    "part.ply": read_mesh,
    "part.obj": read_mesh,
    "part.glb": read_mesh,
    "photo.png": read_image,
    "array.npy": read_npy,
    "arrays.npz": lambda path: read_npz(path, ["a"]),
    "radar.toml": read_table,
    "transform.npy": read_transform,
    "transform.txt": read_transform,
    "model.safetensors": lambda path: load_checkpoint(path, kind="a", version=1),
}


POINTER_KIND, *_ = KINDS


@pytest.mark.parametrize(
    ("name", "kind"), [("log.csv", kind) for kind in KINDS] + [(n, POINTER_KIND) for n in READERS]
)
def test_every_reader_names_the_kind(tmp_path, name, kind):
    path = tmp_path / name
    path.write_bytes(KINDS[kind])
    named, _, todo = kind.partition(": ")
    with pytest.raises(UserError, match=f"{named}.*{todo}"):
        READERS[name](path)


@pytest.mark.parametrize(
    ("content", "reported"),
    [
        (b"\x02\x01\x04\x03\x06\x05\x08\x07" + bytes(range(40)) * 90, "serial port"),
        (b"\x11" * 70 + b"\x02\x01\x04\x03\x06\x05\x08\x07" + BODY, "serial port"),
        (b'{"message": "Not Found"}' * 200, "is text, beginning with"),
        (b"time,x,y\n0,1,2\n" * 400, "is text, beginning with 'time,x,y'"),
        (b"\x93NUMPY\x01\x00" + BODY, "a NumPy array"),
        (b"MATLAB 5.0 MAT-file" + BODY, "a MATLAB file"),
        (b"\x89HDF\r\n\x1a\n" + BODY, "an HDF5 file"),
    ],
)
def test_raw_samples_are_no_text_and_no_container(tmp_path, content, reported):
    (tmp_path / "capture.bin").write_bytes(content)
    with pytest.raises(UserError, match=reported):
        imported("dca1000")(tmp_path / "capture.bin")


def test_a_matlab_file_of_octave_names_what_to_do(tmp_path):
    for head in (b"# Created by Octave 9.0.0\n# name: a\n", b"Octave-1-L\0"):
        (tmp_path / "scan.mat").write_bytes(head)
        with pytest.raises(UserError, match=r"Octave.*save -v7"):
            imported("mat")(tmp_path / "scan.mat")


def test_a_scene_of_pointers_names_the_pointer(tmp_path, capsys):
    (tmp_path / "capture.zarr").mkdir()
    for name in ("scene.toml", "cameras.bin", "images.bin"):
        (tmp_path / name).write_bytes(POINTER)
    assert main(["info", str(tmp_path)]) == 2
    assert "git lfs pull" in capsys.readouterr().err
    with pytest.raises(UserError, match="git lfs pull"):
        read_colmap(tmp_path)


def test_words_of_samples_are_no_other_kind(tmp_path):
    noise = np.random.default_rng(0).normal(0, 300, (50, 4096)).astype("<i2")
    for number, words in enumerate(noise):
        path = tmp_path / f"{number}.bin"
        path.write_bytes(words.tobytes())
        refuse_other_kind(path, is_raw=True)
