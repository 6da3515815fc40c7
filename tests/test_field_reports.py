"""Field reports: inputs of public bug reports, read right or refused in one line."""

import numpy as np
import pytest

from geraf2.apps.importers import ImportOptions, load_importer
from geraf2.apps.importers._recording import open_recording
from geraf2.apps.photos.los import make_los
from geraf2.apps.photos.photo_store import load_photos
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.io.manifest import RadarManifest
from geraf2.io.mesh import read_mesh
from geraf2.io.samples import complex_samples
from geraf2.io.toml import read_toml
from geraf2.pipeline.los_options import LosOptions

pytestmark = pytest.mark.data


@pytest.fixture
def reports(shared_data):
    folder = shared_data / "field_reports"
    if not folder.is_dir():
        pytest.skip("the field reports are absent from ../shared/data")
    return folder


def recording(path, *configs):
    return open_recording(path, RadarManifest(), ImportOptions(config=configs, keep_good=True))


def scan_of(folder, **options):
    radar = read_toml(folder / "radar.toml", RadarManifest)
    return load_importer("dca1000").open(folder / "capture.bin", radar, ImportOptions(**options))


@pytest.mark.parametrize(
    ("name", "layout"),
    [("real_2_lanes.bin", "real-sequential"), ("real_4_lanes.bin", "real-alternating")],
)
def test_real_samples_are_read_once_their_number_is_known(reports, name, layout):
    path = reports / "real_samples" / name
    with pytest.raises(UserError, match="the samples are real"):
        recording(path)
    found = open_recording(path, RadarManifest(n_samples=128), ImportOptions())
    assert (found.evidence.order.layout, found.evidence.n_samples) == (layout, 64)
    assert found.read_frames(0, 1).shape == (1, 1, 1, 4, 64)


def test_pairs_receiver_after_receiver_are_those_of_the_lanes(reports):
    folder = reports / "iq_pairs_receiver_after_receiver"
    radar = read_toml(folder / "radar.toml", RadarManifest)
    signals = [
        open_recording(folder / name, radar).read_frames(0, 64)
        for name in ("capture.bin", "same_as_lanes.bin")
    ]
    np.testing.assert_array_equal(*signals)
    assert any("give it under [raw]" in note for note in recording(folder / "capture.bin").notes)


def test_the_chips_of_a_cascade_are_named(reports):
    with pytest.raises(UserError, match=r"cascade of 4 chips.*master, slave1, slave2, slave3"):
        recording(reports / "cascade_of_four_chips")


@pytest.mark.parametrize(
    "given", [("profile.cfg", "radar.toml"), (None, "radar_with_n_samples.toml")]
)
def test_real_and_imaginary_arrays_of_a_bag_are_joined(reports, given):
    folder = reports / "bag_real_and_imaginary_arrays"
    config, radar = given
    options = ImportOptions(config=() if config is None else (folder / config,))
    radar = read_toml(folder / radar, RadarManifest)
    scan = load_importer("rosbag").open(folder / "scan.mcap", radar, options)
    assert scan.manifest.waveform.n_samples == 64
    assert dict(scan.facts)["frames from"].startswith("real_data and imag_data of /radar/adc")


def scan_of_planes(folder, name, *, radar="radar.toml"):
    options = ImportOptions(positions=folder / "scan.json", config=(folder / "profile.cfg",))
    scan = load_importer("dca1000").open(
        folder / name, read_toml(folder / radar, RadarManifest), options
    )
    return scan, np.concatenate([complex_samples(part.signal) for part in scan.poses()])


@pytest.mark.parametrize("radar", ["radar.toml", "radar_with_layout.toml"])
def test_receivers_that_are_turned_are_turned_back(reports, radar):
    folder = reports / "receivers_turned_round"
    scan, signal = scan_of_planes(folder, "adc_data.bin", radar=radar)
    assert "range bias 0.075 m" in dict(scan.facts)["compensation"]
    plain = open_recording(folder / "not_turned.bin", RadarManifest(n_samples=32))
    right = plain.read_frames(0, plain.n_frames).reshape(signal.shape)
    np.testing.assert_allclose(signal, right)


def test_a_packet_that_is_missing_early_is_put_back_as_zeros(reports):
    folder = reports / "one_packet_missing_early"
    whole = open_recording(reports / "receivers_turned_round" / "not_turned.bin", RadarManifest())
    for configs in ((), (folder / "profile.cfg",)):
        found = recording(folder / "adc_data.bin", *configs)
        assert found.n_frames == whole.n_frames == 3906
        assert any("1 packet of 1456 bytes lost after 853 whole frames" in n for n in found.notes)
    scan, _ = scan_of_planes(folder, "adc_data.bin")
    assert sum(scan.n_antennas) == 4 * 3906


def positions_of(folder, name):
    parts = [part.rx_positions for part in scan_of(folder, positions=folder / name).poses()]
    return np.concatenate(parts)


@pytest.mark.parametrize(
    ("report", "names"),
    [
        ("log_of_ros_topics", ("rostopic_echo_p", "sec_and_nanosec", "nanoseconds_without_unit")),
        ("log_with_lines_before_the_names", ("motive", "vicon", "qualisys")),
    ],
)
def test_logs_of_other_programs_give_the_same_positions(reports, report, names):
    folder = reports / report
    paths = {path.stem: path.name for path in folder.iterdir()}
    right = positions_of(folder, paths.get("as_seconds") or paths["plain"])
    for name in names:
        np.testing.assert_allclose(positions_of(folder, paths[name]), right, atol=1e-6)


def test_compressed_gltf_is_refused_by_the_name_of_its_extension(reports):
    for name, extension in (
        ("draco", "KHR_draco_mesh_compression"),
        ("meshopt", "EXT_meshopt_compression"),
    ):
        with pytest.raises(UserError, match=f"needs {extension}.* export it without compression"):
            read_mesh(reports / "gltf_compressed" / f"{name}.glb")


def test_quantised_gltf_has_the_size_of_the_plain_one(reports):
    plain, quantised = (
        read_mesh(reports / "gltf_compressed" / f"{name}.glb") for name in ("plain", "quantized")
    )
    assert len(plain.faces) == len(quantised.faces) == 432
    for end in ("min", "max"):
        ends = [getattr(mesh.vertices, end)(axis=0) for mesh in (plain, quantised)]
        assert ends[0] == pytest.approx(ends[1], abs=1e-5)


def test_the_outer_skin_of_a_hollow_carton_is_the_prior(reports, tmp_path):
    folder, options = reports / "hollow_carton", LosOptions(unit="mm")
    middles = []
    for name in ("carton_with_walls", "outside_only"):
        made = make_los(folder / f"{name}.stl", tmp_path / name, options)
        values = SdfGrid.load(made.path / "los.npz").values
        middles.append(values[tuple(n // 2 for n in values.shape)])
        assert len(made.prior.faces) == 12
    assert middles[0] == middles[1] == pytest.approx(-0.109, abs=0.002)
    with pytest.raises(UserError, match="hollow"):
        make_los(folder / "carton_open_top.stl", tmp_path / "open", options)


def test_the_largest_model_of_colmap_is_read(reports):
    loaded = load_photos(reports / "colmap_two_models", LosOptions(unit="m"))
    assert len(loaded.photos) == 16
    assert any("'1' (16 photos) is read, not 0 (3)" in note for note in loaded.notes)
