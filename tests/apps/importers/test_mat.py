import h5py
import numpy as np
import pytest
from scipy.io import savemat

from geraf2.apps.importers import ImportOptions, _mat_arrays, _rows, load_importer
from geraf2.errors import UserError
from geraf2.io.manifest import RadarManifest
from helpers.synthetic import WAVEFORM, point_capture

NUMBERS = {
    "start_frequency_hz": WAVEFORM.start_frequency_hz,
    "chirp_slope_hz_per_s": WAVEFORM.chirp_slope_hz_per_s,
    "sample_rate_hz": WAVEFORM.sample_rate_hz,
    "path_bias_m": WAVEFORM.path_bias_m,
}


def save_hdf5(path, arrays):
    """As MATLAB 7.3 does: a user block of 512 bytes, axes reversed, complex as two fields."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in arrays.items():
            array = np.atleast_2d(np.asarray(value)).T
            if array.dtype.kind == "c":
                pair = np.zeros(array.shape, dtype=[("real", "f8"), ("imag", "f8")])
                pair["real"], pair["imag"] = array.real, array.imag
                array = pair
            file[name] = array
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
            if name.endswith("/value"):  # as Octave marks its groups
                del file[name].attrs["MATLAB_class"]
                file[name].parent.attrs["OCTAVE_NEW_FORMAT"] = np.uint8(1)
    return path


def save_python(path, arrays):
    """As h5py does: axes as they are, complex numbers of its own, numbers without axes."""
    with h5py.File(path, "w") as file:
        for name, value in arrays.items():
            file[name] = value
    return path


def save_version_5(path, arrays):
    savemat(path, arrays)
    return path


SAVERS = {"5": save_version_5, "7.3": save_hdf5, "HDF5 of Python": save_python}


@pytest.fixture(params=SAVERS)
def save(request, tmp_path):
    return lambda arrays: SAVERS[request.param](tmp_path / "scan.mat", arrays)


@pytest.fixture
def capture():
    return point_capture(3)


@pytest.fixture
def arrays(capture):
    stack = {
        name: np.stack([getattr(pose, name) for pose in capture.poses])
        for name in ("signal", "tx_positions", "rx_positions", "axes")
    }
    return {**stack, **NUMBERS}


def opened(path, options=None, **radar):
    return load_importer("mat").open(path, RadarManifest(**radar), options or ImportOptions())


@pytest.mark.parametrize("block", [1 << 24, 5000])
def test_poses_are_kept(save, arrays, capture, block, monkeypatch):
    monkeypatch.setattr(_rows, "BLOCK_BYTES", block)
    scan = opened(save(arrays))
    assert scan.n_antennas == (36, 36, 36)
    parts = list(scan.poses())
    for name in ("signal", "tx_positions", "rx_positions"):
        got = np.concatenate([getattr(part, name) for part in parts])
        assert np.allclose(got, np.concatenate([getattr(p, name) for p in capture.poses]))
    assert np.allclose(parts[-1].axes, capture.poses[-1].axes)
    assert vars(scan.manifest.waveform) == pytest.approx(vars(WAVEFORM))


def test_axes_that_are_reversed_without_a_mark_are_turned(tmp_path, arrays, capture):
    turned = {name: np.transpose(value) for name, value in arrays.items()}
    (*_, last) = opened(save_python(tmp_path / "scan.h5", turned)).poses()  # as of Julia
    for name in ("signal", "tx_positions", "rx_positions", "axes"):
        assert np.allclose(getattr(last, name), getattr(capture.poses[-1], name))


def test_one_plane_with_other_names(save, arrays):
    pose = {
        "adc_re": arrays["signal"][1].real,
        "adc_im": arrays["signal"][1].imag,
        "xyz": arrays["tx_positions"][1],
    }
    names = {"signal_real": "adc_re", "signal_imag": "adc_im", "positions": "xyz"}
    numbers = {name: value for name, value in NUMBERS.items() if name != "path_bias_m"}
    scan = opened(save(pose), arrays=names, **numbers)
    (part,) = scan.poses()
    assert np.allclose(part.signal, arrays["signal"][1])
    assert np.array_equal(part.rx_positions, part.tx_positions)
    # The normal of the antennas, towards the origin.
    assert np.allclose(part.axes[0], arrays["axes"][1][0], atol=1e-6)
    assert np.linalg.det(part.axes) == pytest.approx(1)
    assert any("path_bias_m" in note for note in scan.notes)


@pytest.mark.parametrize("name", ["signal", "rx_positions"])
def test_nan_is_refused_or_left_out(save, arrays, name):
    arrays[name] = arrays[name].copy()
    arrays[name][1, 5, 2] = np.nan
    path = save(arrays)
    with pytest.raises(UserError, match="1 of 36 antennas of plane 1 hold NaN, first 5"):
        opened(path)
    scan = opened(path, ImportOptions(keep_good=True))
    assert scan.n_antennas == (36, 35, 36)
    assert all(np.isfinite(part.signal).all() for part in scan.poses())


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("signal", np.zeros((3, 36, 32, 2), complex), "signal has the wrong shape or dtype"),
        ("axes", np.zeros((3, 3)), "rows of axes are not orthonormal"),
        ("axes", np.zeros((2, 3)), "axes has the wrong shape"),
        ("start_frequency_hz", np.zeros(3), "start_frequency_hz must be a number"),
        ("start_frequency_hz", None, "start_frequency_hz is not known"),
    ],
)
def test_arrays_that_do_not_fit_are_named(save, arrays, name, value, text):
    arrays[name] = value
    kept = {key: array for key, array in arrays.items() if array is not None}
    with pytest.raises(UserError, match=text) as caught:
        opened(save(kept))
    assert "scan.mat" in str(caught.value)


@pytest.mark.parametrize("in_struct", [False, True])
def test_no_broken_byte_ends_the_process(tmp_path, in_struct):
    """SciPy alone crashes on some of these: it does not check number types."""
    path = tmp_path / "a.mat"
    values = {"signal": np.ones((4, 8), np.complex64), "positions": np.arange(12.0).reshape(4, 3)}
    savemat(path, {"s": values} if in_struct else values)
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    n_refused = 0
    for _ in range(200):
        broken = bytearray(whole)
        broken[rng.integers(124, len(whole))] = rng.integers(256)
        path.write_bytes(broken[: rng.integers(128, 8 * len(whole))])
        try:
            found, _ = _mat_arrays.open_arrays(path, {name: name for name in values})
            assert set(found) <= set(values)
        except UserError:
            n_refused += 1
    assert n_refused > 30


def _external_link(file, name, other):
    file[name] = h5py.ExternalLink(str(other), "tx_positions")


def _soft_link(file, name, _):
    file[name] = h5py.SoftLink("/rx_positions")


def _raw_file(file, name, other):
    other.write_bytes(bytes(3 * 36 * 3 * 8))
    file.create_dataset(name, (3, 36, 3), "f8", external=[(str(other), 0, h5py.h5f.UNLIMITED)])


def _virtual(file, name, other):
    layout = h5py.VirtualLayout((3, 36, 3), "f8")
    layout[:] = h5py.VirtualSource(str(other), "tx_positions", (3, 36, 3))
    file.create_virtual_dataset(name, layout)


@pytest.mark.parametrize("elsewhere", [_external_link, _soft_link, _raw_file, _virtual])
def test_arrays_of_other_files_are_not_read(tmp_path, arrays, elsewhere):
    path = save_hdf5(tmp_path / "scan.mat", arrays)
    save_hdf5(tmp_path / "private.mat", arrays)
    with h5py.File(path, "a") as file:
        del file["tx_positions"]
        elsewhere(file, "tx_positions", tmp_path / "private.mat")
    with pytest.raises(UserError, match=r"scan.mat: tx_positions (is a link|lies in another file)"):
        opened(path)


def struct_of(arrays):
    """MATLAB struct of one plane in a struct, beside text."""
    plane = {name: arrays[name][1] for name in ("signal", "tx_positions", "rx_positions")}
    return {"data": {"scan": plane, "info": {"name": "carton"}}, **NUMBERS}


@pytest.mark.parametrize("compressed", [False, True])
def test_fields_of_structs_are_found(tmp_path, arrays, compressed):
    savemat(tmp_path / "a.mat", struct_of(arrays), do_compression=compressed)
    (part,) = opened(tmp_path / "a.mat").poses()
    (named,) = opened(tmp_path / "a.mat", arrays={"signal": "data.scan.signal"}).poses()
    for one in (part, named):
        assert np.allclose(one.signal, arrays["signal"][1])


def test_a_file_of_version_4_is_read(tmp_path, arrays):
    plane = {name: arrays[name][1] for name in ("signal", "tx_positions", "rx_positions")}
    savemat(tmp_path / "a.mat", plane, format="4")
    numbers = {name: value for name, value in NUMBERS.items() if name != "path_bias_m"}
    (part,) = opened(tmp_path / "a.mat", **numbers).poses()
    assert np.allclose(part.signal, arrays["signal"][1])


def test_groups_of_hdf5_are_found(tmp_path, arrays):
    """Structs of MATLAB 7.3, and arrays of Octave."""
    plane = struct_of(arrays)["data"]["scan"]
    named = {"scan/signal": plane["signal"], "rx_positions/value": plane["rx_positions"]}
    save_hdf5(tmp_path / "a.mat", named | {"tx_positions": plane["tx_positions"]} | NUMBERS)
    (part,) = opened(tmp_path / "a.mat").poses()
    assert np.allclose(part.signal, arrays["signal"][1])
    assert np.allclose(part.rx_positions, arrays["rx_positions"][1])


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ((), r"lacks the signal(?=.* got .*sarData 36 x 32 \w+)(?=.* got .*\br 36 x 3 \w+)"),
        (("signal=sarData",), r"lacks tx_positions, .* got .*r 36 x 3 "),
        (("signal=sardata", "positions=r"), "lacks what is named: signal = sardata"),
        (("signal",), "must be OURS=THEIRS, got signal"),
        (("range=r",), "arrays.range is no array that is read"),
    ],
)
def test_names_that_are_missing_list_what_there_is(save, arrays, given, text):
    pose = {"sarData": arrays["signal"][1], "r": arrays["tx_positions"][1]}
    with pytest.raises(UserError, match=text):
        opened(save({**pose, **NUMBERS}), ImportOptions(arrays=given))


def test_what_is_in_a_struct_and_what_cannot_be_read_is_listed(tmp_path, arrays):
    values = {"s": {"adc": arrays["signal"][1]}, "cells": np.array([1, "a"], dtype=object)}
    savemat(tmp_path / "a.mat", values)
    with pytest.raises(UserError, match=r"s\.adc 36 x 32 complex, cells 1 x 2 cell"):
        opened(tmp_path / "a.mat")
