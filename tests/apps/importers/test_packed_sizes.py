"""Small files that unpack to any size: refused before they are unpacked."""

import tracemalloc

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from geraf2.apps.importers import load_importer
from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest
from helpers.ros_bag import scan_path, write_bag

N_ANTENNAS, N_BYTES = 1 << 17, 1 << 27
"""An eighth of a gigabyte of zeros, which packs to some hundred kilobytes."""
PLACES = np.random.default_rng(0).uniform(size=(N_ANTENNAS, 3)) * [0, 1, 1] + [0.3, 0, 0]


def zeros():
    return np.zeros((N_ANTENNAS, N_BYTES // N_ANTENNAS // 16), dtype=complex)


def mat(path, *, in_struct=False):
    arrays = {"signal": zeros(), "positions": 0 * PLACES if in_struct else PLACES}
    savemat(path, {"scan": arrays} if in_struct else arrays, do_compression=True)


def sparse_hdf5(path):
    with h5py.File(path, "w") as file:
        shape = zeros().shape
        signal = file.create_dataset("signal", shape, "c16", chunks=(1024, shape[1]))
        file["positions"] = PLACES
        signal[:1] = 1.0  # all others are a value that no chunk holds


def packed_hdf5(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("signal", data=zeros(), compression="gzip", shuffle=True)
        file["positions"] = PLACES


def signals(path):
    signal, locations = zeros()[..., None], PLACES
    np.savez_compressed(path, received_signals=signal, antenna_locations=locations)


def locations(path):
    signal, many = np.ones((9, 9, 1), complex), np.zeros((N_BYTES // 24, 3))
    np.savez_compressed(path, received_signals=signal, antenna_locations=many)


def bag(path, **how):
    words = [np.zeros(N_BYTES // 128, dtype="<i2")] * 64
    write_bag(path, scan_path(1), (np.arange(64.0), words), **how)


@pytest.mark.parametrize(
    ("format_name", "name", "write"),
    [
        ("mat", "a.mat", mat),
        ("mat", "a.mat", lambda path: mat(path, in_struct=True)),
        ("mat", "a.h5", sparse_hdf5),
        ("mat", "a.h5", packed_hdf5),
        ("mmnorm", "a.npz", signals),
        ("mmnorm", "a.npz", locations),
        ("rosbag", "bag", lambda path: bag(path, compression="STORAGE")),
        ("rosbag", "bag", lambda path: bag(path, compression="FILE", storage="SQLITE3")),
        ("rosbag", "bag", lambda path: bag(path, compression="MESSAGE", storage="SQLITE3")),
    ],
)
def test_files_that_unpack_to_any_size_are_refused_before(tmp_path, format_name, name, write):
    write(tmp_path / name)
    size = sum(path.stat().st_size for path in [*tmp_path.rglob("*")] if path.is_file())
    assert size < N_BYTES / 20
    importer = load_importer(format_name)
    tracemalloc.start()
    try:
        with pytest.raises(UserError, match=r"MiB unpack to .* GiB.*save it without compression"):
            importer.open(tmp_path / name, RadarManifest())
        assert tracemalloc.get_traced_memory()[1] < N_BYTES / 4
    finally:
        tracemalloc.stop()


def test_a_chunk_that_states_too_few_bytes_is_refused_before_it_is_unpacked(tmp_path):
    bag(tmp_path / "bag", compression="STORAGE")
    (path,) = (tmp_path / "bag").glob("*.mcap")
    data = bytearray(path.read_bytes())
    at = len(b"\x89MCAP0\r\n")
    while data[at] != 6:  # the kind of a chunk
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    data[at + 25 : at + 33] = (1000).to_bytes(8, "little")
    path.write_bytes(data)
    tracemalloc.start()
    try:
        with pytest.raises(UserError, match="more bytes than it states"):
            load_importer("rosbag").open(tmp_path / "bag", RadarManifest())
        assert tracemalloc.get_traced_memory()[1] < N_BYTES / 2
    finally:
        tracemalloc.stop()
