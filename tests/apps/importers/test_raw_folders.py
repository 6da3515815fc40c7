"""Folders of raw recordings: parts of one, captures of their own, one file for each position."""

import numpy as np
import pytest

from geraf2.apps.importers import ImportOptions, load_importer
from geraf2.apps.importers._recording import open_recording
from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest, RasterManifest
from helpers.raw_capture import (
    BOARD_RX,
    RADAR,
    beat,
    packets_of,
    raster_positions,
    scan_signal,
    whole_pose,
    words_of,
    write_words,
)

BOARD = {**RADAR, "antennas": {"rx_offsets_m": BOARD_RX.tolist()}}
RASTER = RasterManifest(n_rows=4, n_columns=4, row_step_m=0.01, column_step_m=0.01)
POSITIONS = raster_positions(4, 4, 0.01)
DATA = words_of(beat()).tobytes()


def write(folder, pieces, name="scan_{}.bin"):
    folder.mkdir(exist_ok=True)
    for number, piece in enumerate(pieces):
        (folder / name.format(number)).write_bytes(piece)
    return folder


def recorded(n_chirps=2):
    """File of each position of the raster: chirps of it that differ by nothing."""
    return [words_of(np.repeat(one[None], n_chirps, 0)).tobytes() for one in scan_signal(POSITIONS)]


@pytest.mark.parametrize(
    ("name", "pieces", "text"),
    [
        ("scan_{}.bin", [DATA, DATA, DATA], "all are of one size"),
        ("adc_data_Raw_{}.bin", [DATA, DATA * 2], "parts are of one size"),
        ("scan_{}0.bin", [DATA, DATA[:1024]], "do not follow each other"),
        ("scan_{}_Raw.bin", [DATA, DATA[:1024]], "names differ in more than a last number"),
        ("adc_data_Raw_{}.bin", [b"".join(packets_of(DATA))] * 2, "packet numbers begin anew"),
    ],
)
def test_captures_of_their_own_are_named_and_not_joined(tmp_path, name, pieces, text):
    folder = write(tmp_path, pieces, name)
    with pytest.raises(UserError, match=text) as caught:
        open_recording(folder, RadarManifest())
    assert all(name.format(number) in str(caught.value) for number in range(len(pieces)))
    assert "file_per_position" in str(caught.value)


def test_files_of_any_name_are_joined_with_a_word(tmp_path):
    folder = write(tmp_path, [DATA[:30000], DATA[30000:]])
    (note,) = open_recording(folder, RadarManifest()).notes
    assert note == ("2 files were joined as the parts of one recording: scan_0.bin, scan_1.bin")


def opened(folder, positions=None, *, keep_good=False, **radar):
    options = ImportOptions(
        file_per_position=positions is None, positions=positions, keep_good=keep_good
    )
    raster = {"raster": RASTER} if positions is None else {}
    manifest = RadarManifest.model_validate({**BOARD, **raster, **radar})
    return load_importer("dca1000").open(folder, manifest, options)


@pytest.mark.parametrize("n_chirps", [1, 2, 5])
def test_each_file_is_a_position_of_the_raster(tmp_path, n_chirps):
    scan = opened(write(tmp_path / "scan", recorded(n_chirps), "position {}.bin"))
    signal, tx, _ = whole_pose(scan)
    assert np.allclose(tx, np.repeat(POSITIONS, 4, axis=0), atol=1e-12)
    assert np.allclose(signal, scan_signal(POSITIONS).reshape(-1, 64), rtol=1e-6)
    assert scan.integers == (n_chirps == 1)
    assert dict(scan.facts)["files"] == "16, one for each position"


def rows(folder, names, positions=POSITIONS):
    path = folder.parent / "log.csv"
    lines = [f"{name},{x},{y},{z}" for name, (x, y, z) in zip(names, positions, strict=True)]
    path.write_text("\n".join(["file,x_m,y_m,z_m", *lines]))
    return path


def test_positions_name_their_files(tmp_path):
    folder = write(tmp_path / "scan", recorded())
    (folder / "notes_of_another.bin").write_bytes(b"12")
    order = np.random.default_rng(0).permutation(16)
    log = rows(folder, [f"scan_{k}.bin" for k in order], POSITIONS[order])
    signal, tx, _ = whole_pose(opened(folder, log))
    assert np.allclose(tx, np.repeat(POSITIONS[order], 4, axis=0), atol=1e-12)
    assert np.allclose(signal, scan_signal(POSITIONS[order]).reshape(-1, 64), rtol=1e-6)


def test_a_position_with_too_few_frames_is_refused_or_left_out(tmp_path):
    pieces = recorded(3)
    pieces[5] = pieces[5][:2048]
    folder = write(tmp_path / "scan", pieces)
    with pytest.raises(UserError, match=r"1 of 16 files do not hold 3 frames .* scan_5\.bin \(2\)"):
        opened(folder)
    scan = opened(folder, keep_good=True)
    signal, tx, _ = whole_pose(scan)
    kept = np.delete(np.arange(16), 5)
    assert np.allclose(tx, np.repeat(POSITIONS[kept], 4, axis=0), atol=1e-12)
    assert np.allclose(signal, scan_signal(POSITIONS[kept]).reshape(-1, 64), rtol=1e-6)
    assert any("scan_5.bin (2); left out" in note for note in scan.notes)


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (["../scan/scan_0.bin"], "a file of the positions is not named plainly"),
        (["..\\scan_0.bin"], "a file of the positions is not named plainly"),
        (["/etc/passwd"], "a file of the positions is not named plainly"),
        (["scan_1.bin"], "two positions name the same file"),
        (["scan_99.bin"], r"1 of 16 files that the positions name are not there, got scan_99\.bin"),
    ],
)
def test_names_of_files_are_names_in_the_folder(tmp_path, names, text):
    folder = write(tmp_path / "scan", recorded())
    log = rows(folder, [*names, *[f"scan_{k}.bin" for k in range(1, 16)]])
    with pytest.raises(UserError, match=text):
        opened(folder, log)


def test_an_empty_position_is_refused_or_left_out(tmp_path):
    folder = write(tmp_path / "scan", [*recorded()[:-1], b""])
    with pytest.raises(UserError, match=r"scan_15\.bin: is empty"):
        opened(folder)
    assert opened(folder, keep_good=True).n_antennas == (15 * 4,)


def test_one_position_and_many_exclude_each_other(tmp_path):
    folder = write(tmp_path / "scan", recorded())
    options = ImportOptions(file_per_position=True, static=True)
    with pytest.raises(UserError, match="static has one position"):
        load_importer("dca1000").open(folder, RadarManifest.model_validate(BOARD), options)
    with pytest.raises(UserError, match="is no folder with one file for each position"):
        open_recording(folder / "scan_0.bin", RadarManifest(), options)


@pytest.mark.parametrize("chips", [("master", "slave1"), ("dev0", "dev1", "dev2", "dev3")])
@pytest.mark.parametrize("per_position", [False, True])
def test_the_chips_of_a_cascade_are_no_positions(tmp_path, chips, per_position):
    for chip in chips:
        write_words(tmp_path / f"{chip}_0000_data.bin", beat(), "iq")
        (tmp_path / f"{chip}_0000_idx.bin").write_bytes(bytes(24))
    options = ImportOptions(file_per_position=per_position)
    with pytest.raises(UserError, match=f"cascade of {len(chips)} chips.*name one file") as caught:
        open_recording(tmp_path, RadarManifest(), options)
    assert "file-per-position" not in str(caught.value)
    # The hint is obeyed: one file, or the folder of one chip, whose index is left aside.
    assert open_recording(tmp_path / f"{chips[0]}_0000_data.bin", RadarManifest()).n_frames == 40
    for chip in chips[1:]:
        (tmp_path / f"{chip}_0000_data.bin").unlink()
    assert open_recording(tmp_path, RadarManifest()).n_frames == 40
