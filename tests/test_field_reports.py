"""Field reports: inputs of public bug reports, read right or refused in one line."""

import json
from base64 import b64encode

import numpy as np
import pytest

from geraf2.apps.importers import ImportOptions, load_importer
from geraf2.apps.importers._recording import open_recording
from geraf2.apps.photos.los import make_los
from geraf2.apps.photos.photo_store import load_photos
from geraf2.cli.main import main
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.geometry.triangles import enclosed_volume_m3
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


@pytest.mark.parametrize("config", ["profile.cfg", "profile.mmwave.json"])
def test_two_transmitters_at_once_are_separated(reports, config):
    folder = reports / "bpm_two_transmitters"
    scan = scan_of(folder, config=(folder / config,), static=True)
    assert "masks 5, 5, 2" in dict(scan.facts)["transmitters"]
    signal = np.concatenate([part.signal for part in scan.poses()])
    # Each transmitter alone has an amplitude of 2000; sums and differences have others.
    assert np.abs(signal).mean(axis=1) == pytest.approx(np.full(12, 2000), rel=0.001)


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


@pytest.mark.parametrize("name", ["two_lanes.bin", "four_lanes.bin"])
@pytest.mark.parametrize("given", [False, True])
def test_headers_of_chirps_are_removed(reports, name, given):
    folder = reports / "stream_headers"
    found = recording(folder / name, *([folder / "profile.cfg"] if given else []))
    assert (found.evidence.n_samples, found.evidence.order.n_rx) == (64, 4)
    assert any("64 bytes before each 1024 were removed" in note for note in found.notes)


@pytest.mark.parametrize("n_more", [0, 400000])
def test_zeros_at_the_start_are_left_out_and_named(reports, tmp_path, n_more):
    data = (reports / "zeros_at_the_start" / "no_whole_chirps.bin").read_bytes()
    (tmp_path / "a.bin").write_bytes(bytes(n_more) + data)
    found = recording(tmp_path / "a.bin")
    assert (found.evidence.n_samples, found.n_frames) == (32, 32)
    assert any(f"the first {1000 + n_more} bytes of a.bin are zero" in n for n in found.notes)


def test_a_script_with_branches_is_refused_with_both_values(reports):
    folder = reports / "script_with_branches"
    with pytest.raises(UserError, match=r"line 6: .* line 4, .* 77, 5000, got 60\.25, 10000"):
        recording(folder / "capture.bin", folder / "setup.lua")


def test_settings_of_mmwave_studio_are_read(reports):
    folder = reports / "studio_settings_xml"
    config = recording(folder / "capture.bin", folder / "mmWaveConfig.xml").config
    assert (config.ramp_start_hz, config.chirp_slope_hz_per_s) == (77e9, 60e12)
    assert (config.n_samples, config.sample_rate_hz, config.frame_period_s) == (64, 5e6, 0.04)
    assert config.transmitters.masks == (1,)


def test_pairs_receiver_after_receiver_are_those_of_the_lanes(reports):
    folder = reports / "iq_pairs_receiver_after_receiver"
    radar = read_toml(folder / "radar.toml", RadarManifest)
    signals = [
        open_recording(folder / name, radar).read_frames(0, 64)
        for name in ("capture.bin", "same_as_lanes.bin")
    ]
    np.testing.assert_array_equal(*signals)
    assert any("give it under [raw]" in note for note in recording(folder / "capture.bin").notes)


@pytest.mark.parametrize("n_together", [1, 4])
def test_blocks_of_i_and_q_are_no_real_samples(reports, tmp_path, n_together):
    folder = reports / "iq_pairs_receiver_after_receiver"
    pairs = np.fromfile(folder / "capture.bin", "<i2").reshape(-1, n_together, 64, 2)
    np.moveaxis(pairs, -1, 1).tofile(tmp_path / "a.bin")
    radar = read_toml(folder / "radar.toml", RadarManifest)
    with pytest.raises(UserError, match="write I and Q as arrays"):
        open_recording(tmp_path / "a.bin", radar)


@pytest.mark.parametrize("name", ["complex64.bin", "float32_iq.bin"])
def test_floats_are_named(reports, name):
    with pytest.raises(UserError, match="floating-point numbers of 32 bits, not words of 16"):
        recording(reports / "floats_in_a_bin" / name)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        (">f4", "floating-point numbers of 32 bits"),
        ("<f2", "floating-point numbers of 16 bits"),
        ("<i4", "integers of 32 bits"),
        ("i1", "integers of 8 bits"),
        (">i2", "big-endian integers of 16 bits"),
    ],
)
def test_numbers_of_other_kinds_are_named(reports, tmp_path, kind, text):
    floats = np.fromfile(reports / "floats_in_a_bin" / "float32_iq.bin", "<f4")
    numbers = {"<f2": 1e-4, "i1": 0.015}.get(kind, 1.0) * floats
    (numbers if kind[1] == "f" else np.round(numbers)).astype(kind).tofile(tmp_path / "a.bin")
    with pytest.raises(UserError, match=text):
        recording(tmp_path / "a.bin")


def test_the_chips_of_a_cascade_are_named(reports):
    with pytest.raises(UserError, match=r"cascade of 4 chips.*master, slave1, slave2, slave3"):
        recording(reports / "cascade_of_four_chips")


@pytest.mark.parametrize("per_position", [False, True])
def test_chips_of_a_cascade_by_number_are_no_positions(reports, tmp_path, per_position):
    for k, path in enumerate(sorted((reports / "cascade_of_four_chips").glob("*_data.bin"))):
        (tmp_path / f"dev{k}_0000_data.bin").write_bytes(path.read_bytes())
    with pytest.raises(UserError, match="cascade of 4 chips"):
        open_recording(tmp_path, RadarManifest(), ImportOptions(file_per_position=per_position))


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


def lossy(reports, path, lost):
    """The whole recording less some packets, and its configuration."""
    data = (reports / "receivers_turned_round" / "not_turned.bin").read_bytes()
    packets = [data[at : at + 1456] for at in range(0, len(data), 1456)]
    path.write_bytes(
        b"".join(p for k, p in enumerate(packets) if k not in range(len(packets))[lost])
    )
    return path, reports / "one_packet_missing_early" / "profile.cfg"


@pytest.mark.parametrize(
    ("lost", "n_lost"),
    [(slice(0, 1), 1), (slice(1, 2), 1), (slice(301, 303), 2), (slice(199, None, 200), 6)],
)
def test_packets_that_are_missing_elsewhere_are_put_back_as_zeros(reports, tmp_path, lost, n_lost):
    whole = reports / "receivers_turned_round" / "not_turned.bin"
    right = open_recording(whole, RadarManifest(n_samples=32)).read_frames(0, 3906)
    found = recording(*lossy(reports, tmp_path / "a.bin", lost))
    assert found.n_frames == 3906
    differing = (found.read_frames(0, 3906) != right).mean()
    assert differing == pytest.approx(n_lost * 364 / right.size, rel=0.3)


@pytest.mark.parametrize("step", [3, 5, 10, 20])
@pytest.mark.parametrize("given", [False, True])
def test_packets_that_are_missing_everywhere_are_no_chirps(reports, tmp_path, step, given):
    path, config = lossy(reports, tmp_path / "a.bin", slice(step - 1, None, step))
    with pytest.raises(UserError, match="packets are missing at many places") as caught:
        recording(path, *([config] if given else []))
    assert "n_samples" not in str(caught.value)


@pytest.mark.parametrize("given", [False, True])
def test_missing_packets_are_no_chirps(reports, given):
    folder = reports / "every_second_packet_missing"
    with pytest.raises(UserError, match="jumps every 1456 bytes, the payload") as caught:
        recording(folder / "adc_data.bin", *([folder / "profile.cfg"] if given else []))
    assert "n_samples" not in str(caught.value)


def test_dialects_of_logs(reports):
    folder = reports / "log_dialects"
    for name in ("comma_at_end.csv", "quoted_names.csv"):
        assert scan_of(folder, positions=folder / name).n_antennas == (256,)
    with pytest.raises(UserError, match=r"0\.1 % of the 2520 s .* name the column time_ms"):
        scan_of(folder, positions=folder / "time_in_ms.csv")


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


def test_rotation_vectors_turn_the_antennas(reports):
    folder = reports / "log_rotation_vector"
    parts = [positions_of(folder, name) for name in ("log.csv", "same_as_quaternions.csv")]
    np.testing.assert_allclose(parts[0], parts[1], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("names.mat", "sarData 16 x 8 .*, xyz_m 16 x 3 "),
        ("octave_text.mat", "Octave.*save -v7"),
    ],
)
def test_other_names_of_matlab_are_listed(reports, name, text):
    with pytest.raises(UserError, match=text):
        load_importer("mat").open(reports / "mat_other_names" / name, RadarManifest())


def test_hdf5_of_python_is_read_as_it_stands(reports):
    scan = load_importer("mat").open(reports / "hdf5_of_python" / "scan.h5", RadarManifest())
    assert (scan.n_antennas, scan.manifest.waveform.n_samples) == ((256,), 64)


def test_structs_of_matlab_are_opened(reports):
    radar = RadarManifest(
        start_frequency_hz=77e9, chirp_slope_hz_per_s=6e13, sample_rate_hz=1e6, path_bias_m=0.0
    )
    with pytest.raises(UserError, match="viewing direction is not known") as caught:
        load_importer("mat").open(reports / "mat_other_names" / "struct.mat", radar)
    assert "lacks" not in str(caught.value)


@pytest.mark.parametrize(
    "line",
    [
        "info capture.bin",
        "import dca1000 capture.bin OUT --static",
        "los part.stl OUT",
        "los part.obj OUT",
        "los part.ply OUT",
        "import mat scan.mat OUT",
        "import planar scan.npy OUT",
    ],
)
def test_pointers_are_named(reports, tmp_path, monkeypatch, capsys, line):
    monkeypatch.chdir(reports / "lfs_pointer")
    assert main(line.replace("OUT", str(tmp_path / "out")).split()) == 2
    assert "git lfs pull" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_relative_indices_count_from_their_line(reports):
    mesh = read_mesh(reports / "obj_relative_indices" / "two_parts.obj", any_unit=True)
    assert np.ptp(mesh.vertices, axis=0).tolist() == [110, 40, 20]
    assert enclosed_volume_m3(mesh.vertices, mesh.faces) == pytest.approx(49000)


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


def test_the_hint_for_a_quantised_mesh_in_millimetres_leads_to_its_size(reports, tmp_path, capsys):
    data = (reports / "gltf_compressed" / "quantized.glb").read_bytes()
    end = 20 + int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20:end])
    tree["nodes"].append({"children": tree["scenes"][0]["nodes"], "scale": [1000] * 3})
    tree["scenes"][0]["nodes"] = [len(tree["nodes"]) - 1]
    tree["buffers"][0]["uri"] = f"data:;base64,{b64encode(data[end + 8 :]).decode()}"
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    line = ["los", str(tmp_path / "a.gltf"), str(tmp_path / "out")]
    assert main(line) == 2
    assert "then add --unit mm" in capsys.readouterr().err
    assert main([*line, "--unit", "mm"]) == 0
    size = np.ptp(read_mesh(tmp_path / "out" / "los.ply").vertices, axis=0)
    assert size == pytest.approx([0.2, 0.04, 0.1], abs=1e-4)


@pytest.mark.parametrize(
    "name", ["face_colours_as_a_list", "face_flags_not_in_header", "vertex_alpha_not_in_header"]
)
def test_rows_that_the_header_does_not_state_are_refused_by_line(reports, name):
    with pytest.raises(UserError, match=r"line \d+ has \d+ words, the header states \d+"):
        read_mesh(reports / "ply_rows_and_header_differ" / f"{name}.ply")
    assert len(read_mesh(reports / "ply_rows_and_header_differ" / "right.ply").faces) == 12


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


def test_photos_that_are_stored_upside_down_are_named(reports):
    loaded = load_photos(reports / "photo_upside_down", LosOptions(unit="m"))
    assert any("8 photos with an EXIF orientation" in note for note in loaded.notes)
