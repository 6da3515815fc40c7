"""Captures of other programs: frames, raw recordings, MATLAB files, settings and positions."""

import io
import zipfile

import numpy as np
from scipy.io import savemat

from bad_inputs.lines import IMPORT, RAW, UNPLACED
from bad_inputs.table import (
    bad,
    cut,
    drop,
    flip,
    folder,
    keys,
    link,
    npy,
    npz,
    put,
    set_at,
    swap,
    toml,
    values,
)


def mat_file(**arrays):
    """A MATLAB file of version 5, compressed, the same each time: its text names the time."""
    file = io.BytesIO()
    savemat(file, arrays, do_compression=True)
    text = b"MATLAB 5.0 MAT-file"
    return text.ljust(116) + file.getvalue()[116:]


def bomb(shape):
    """An .npz whose array of zeros unpacks to far more than it takes."""
    file = io.BytesIO()
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<c16", "fortran_order": False, "shape": shape}
    )
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("received_signals.npy", "antenna_locations.npy"):
            # With a date of its own: a name alone takes the time.
            archive.writestr(
                zipfile.ZipInfo(name), header.getvalue() + bytes(64), zipfile.ZIP_DEFLATED
            )
    return file.getvalue()


MAT, NORM, PLANAR = (
    "import mat scan.mat out",
    "import mmnorm norm.npz out",
    "import planar planar out",
)
FRAME, TWO = "frames/mf/1_120_0", "frames/mf/2_240_0"
ROBOT = "time_s,x_m,y_m,z_m\n"

ROWS = [
    *(bad(IMPORT, drop(f"{FRAME}/{name}.npy")) for name in ("tpos", "adcr", "rotation")),
    *(bad(IMPORT, put(f"{FRAME}/{name}.npy", b"")) for name in ("rpos", "adci")),
    *(bad(IMPORT, cut(f"{FRAME}/{name}.npy")) for name in ("tpos", "adcr", "rotation")),
    bad(IMPORT, npy(f"{FRAME}/tpos.npy", "in mm", lambda a: 1000 * a), says="transmitter"),
    bad(
        IMPORT,
        *(npy(f"{FRAME}/{n}.npy", "in mm", lambda a: 1000 * a) for n in ("tpos", "rpos")),
        says="metres",
    ),
    bad(IMPORT, npy(f"{FRAME}/rotation.npy", "x 2", lambda a: 2 * a)),
    bad(IMPORT, npy(f"{FRAME}/rotation.npy", "0", lambda a: 0 * a)),
    bad(IMPORT, npy(f"{FRAME}/rotation.npy", "NaN", lambda a: a * float("nan"))),
    bad(IMPORT, npy(f"{FRAME}/adcr.npy", "one short", lambda a: a[:-1])),
    bad(IMPORT, npy(f"{FRAME}/adcr.npy", "integers", lambda a: a.astype("i4"))),
    bad(IMPORT, npy(f"{FRAME}/rpos.npy", "NaN", set_at((3, "nan")))),
    bad(IMPORT, npy(f"{FRAME}/rpos.npy", "1e30", set_at((3, 1e30))), says="1e+30"),
    bad(IMPORT, link(FRAME, "nowhere"), says="1_120_0"),
    bad(IMPORT, link(FRAME, "1_120_0"), says="1_120_0"),
    bad(IMPORT, put("frames/capture.json", "[]")),
    bad(IMPORT, put("frames/capture.json", "{")),
    bad(IMPORT, put("frames/capture.json", b"\xff")),
    bad(IMPORT, put("frames/capture.json", "[" * 100000)),
    bad(
        IMPORT, values("frames/capture.json", path_bais_m=0.15, path_bias_m=...), says="path_bais_m"
    ),
    bad(IMPORT, values("frames/capture.json", box_size=0.22), says="box_size"),
    bad(IMPORT, values("frames/capture.json", start_frequency_hz=77.0), says="start_frequency_hz"),
    bad(IMPORT, values("frames/capture.json", start_frequency_hz="77e9"), says="frequency"),
    bad(IMPORT, values("frames/capture.json", chirp_slope_hz_per_s=-7e13), says="slope"),
    bad(IMPORT, values("frames/capture.json", adc_sample_rate_hz=...), says="sample_rate"),
    bad(IMPORT, values("frames/capture.json", n_adc_samples=31), says="n_samples"),
    bad(IMPORT, values("frames/capture.json", path_bias_m=1e9), says="path_bias_m"),
    bad(IMPORT, values("frames/capture.json", wall_permittivity=0.1), says="permittivity"),
    bad(
        IMPORT,
        values(
            "frames/capture.json",
            box_size_m=[0.2, 0.3],
            wall_thickness_m=[0.004] * 2,
            wall_permittivity=[1.6, 1.6],
        ),
        says="outermost first",
    ),
    bad(IMPORT + " --phase-sign 2", says="--phase-sign"),
    bad(IMPORT + " --threads 0", says="--threads"),
    bad(IMPORT + " --radar nowhere.toml", says="nowhere.toml"),
    bad(
        IMPORT + " --radar radar.toml", toml("radar.toml", "path_bais_m", "0.1"), says="path_bais_m"
    ),
    *keys(
        RAW,
        "radar.toml",
        """
        start_frequency_hz 77 -1 nan
        chirp_slope_hz_per_s 60 inf
        sample_rate_hz 0 "fast"
        adc_start_s -1 nan 2
        n_samples 0 63 9999999
        raw.n_rx 0 100
        raw.layout "other"
        raw.frame_period_s 0 -1
        antennas.rx_offsets_m []|[[1,2]]|[[0,0,nan]]
        """,
    ),
    bad(RAW, toml("radar.toml", "raw.n_rx", "3"), says="receivers"),
    bad(RAW, put("raw/adc.bin", b"")),
    bad(RAW, put("raw/adc.bin", bytes(7))),
    bad(RAW, put("raw/adc.bin", bytes(40000))),
    bad(RAW, cut("raw/adc.bin", 0.97)),
    bad(RAW, cut("raw/adc.bin", 0.5)),
    bad("import dca1000 raw/adc.bin out --radar radar.toml", says="--raster"),
    bad("import dca1000 raw/adc.bin out --radar radar.toml --raster 0 6 1 1", says="--raster"),
    bad("import dca1000 raw/adc.bin out --radar radar.toml --raster 6 6 nan 1", says="--raster"),
    bad("import dca1000 raw/adc.bin out --radar radar.toml --raster 5 5 0.004 0.004", says="36"),
    bad("import dca1000 raw/adc.bin out --radar radar.toml --serpentine", says="--raster"),
    bad(UNPLACED + " --positions nowhere.csv", says="nowhere.csv"),
    *(
        bad(UNPLACED + " --positions robot.csv", change)
        for change in (
            put("robot.csv", ""),
            put("robot.csv", "time_s,x_m,y_m,z_m\n"),
            put("robot.csv", b"\x00\xff"),
            put("robot.csv", "time_s,x_m,y_m,z_m\n0,0,0\n"),
            put("robot.csv", "time_s,x_m,y_m\n0,0,0\n"),
            put("robot.csv", "time_s,x_m,y_m,z_m\n1,0,0,0\n0,0,0,0\n"),
            put("robot.csv", "time_s,x_m,y_m,z_m\n0,nan,0,0\n1,0,0,0\n"),
            put("robot.csv", "time_s,x_m,y_m,z_m\n0,a,0,0\n1,0,0,0\n"),
        )
    ),
    bad("import mat scan.mat out", put("scan.mat", b"")),
    bad("import mat scan.mat out", put("scan.mat", b"MATLAB" * 40)),
    bad("import mat scan.mat out", cut("scan.mat")),
    bad("import mat scan.mat out", cut("scan.mat", 0.999)),
    bad("import mat scan.mat out", flip("scan.mat", 128)),
    bad("import mat scan.mat out", flip("scan.mat", 144)),
    bad("import mmnorm norm.npz out", cut("norm.npz")),
    bad("import mmnorm norm.npz out", put("norm.npz", b"PK\x03\x04" + bytes(50))),
    bad("import mmnorm norm.npz out", npz("norm.npz", "no signals", received_signals=None)),
    bad("import mmnorm norm.npz out", npz("norm.npz", "NaN", antenna_locations=set_at((0, "nan")))),
    bad(
        "import mmnorm norm.npz out",
        npz("norm.npz", "in mm", antenna_locations=lambda a: 1000 * a),
        says="metres",
    ),
    bad("import planar planar out", cut("planar/scan.npy"), says="scan.npy"),
    bad("import planar planar out", put("planar/scan.npy", b""), says="scan.npy"),
    bad("import planar planar out", put("planar/antenna_phase.txt", "a b"), says="antenna_phase"),
    bad("import planar planar out", flip("planar/scan.npy", 20), says="scan.npy"),
    *(bad(IMPORT, drop(f"{FRAME}/{name}.npy")) for name in ("rpos", "adci")),
    *(bad(IMPORT, put(f"{TWO}/{name}.npy", b"\x93NUMPY")) for name in ("tpos", "adcr", "rotation")),
    *(bad(IMPORT, flip(f"{TWO}/{name}.npy", 12)) for name in ("tpos", "adcr", "adci", "rpos")),
    bad(IMPORT, npy(f"{TWO}/tpos.npy", "2 columns", lambda a: a[:, :2])),
    bad(IMPORT, npy(f"{TWO}/adcr.npy", "no samples", lambda a: a[:, :0])),
    bad(IMPORT, npy(f"{TWO}/adci.npy", "text", lambda a: a.astype("U9"))),
    bad(IMPORT, npy(f"{TWO}/adci.npy", "NaN", lambda a: a * float("nan"))),
    bad(IMPORT, npy(f"{TWO}/rotation.npy", "4 x 4", lambda a: np.eye(4))),
    bad(IMPORT, npy(f"{TWO}/rotation.npy", "inf", lambda a: a + float("inf"))),
    bad(IMPORT, npy(f"{TWO}/rpos.npy", "in mm", lambda a: 1000 * a), says="transmitter"),
    bad(IMPORT, put("frames/mf/3_300_0", "a file"), says="3_300_0"),
    bad(IMPORT, link("frames/mf/3_300_0", "../../nowhere"), says="3_300_0"),
    bad(IMPORT, link("frames/mf", "nowhere"), says="frames"),
    bad(IMPORT, link(f"{FRAME}/tpos.npy", "nowhere")),
    bad(IMPORT, folder(f"{FRAME}/tpos.npy")),
    *(
        bad(IMPORT, values("frames/capture.json", **{key: value}), says=says)
        for key, value, says in (
            ("n_pose", 3, "n_pose"),
            ("start_freqency_hz", 77e9, "start_freqency_hz"),
            ("wall_thicknes_m", 0.004, "wall_thicknes_m"),
            ("box_size_m", "big", "box_size_m"),
            ("box_size_m", [-0.2], "size_m"),
            ("box_size_m", [[0.2, 0.2]], "size_m"),
            ("wall_thickness_m", [0.1, 0.2], "wall_thickness_m"),
            ("wall_thickness_m", 0.2, "thickness_m"),
            ("wall_permittivity", None, "permittivity"),
            ("path_bias_m", "long", "path_bias_m"),
            ("path_bias_m", True, "path_bias_m"),
            ("n_adc_samples", -1, "n_samples"),
            ("adc_sample_rate_hz", [1], "sample_rate"),
            ("chirp_slope_hz_per_s", 70.15, "slope"),
        )
        if value is not None
    ),
    *keys(
        IMPORT + " --radar radar.toml",
        "radar.toml",
        """
        walls 3
        antennas.axes [[1,0,0],[0,1,0]]|[[1,0,0]]
        raw.n_tx 0 99
        raw.offset_binary "yes" 1
        raw.start_time_s "noon"
        arrays 3
        """,
    ),
    bad("info raw/adc.bin --radar radar.toml", toml("radar.toml", "raw.n_rx", "0"), says="n_rx"),
    bad("info raw/adc.bin --config studio.mmwave.json", put("studio.mmwave.json", "{")),
    bad("info raw/adc.bin --config studio.mmwave.json", put("studio.mmwave.json", "[]")),
    bad("info raw/adc.bin --config nowhere.json", says="nowhere.json"),
    *(
        bad(f"{RAW} --config studio.mmwave.json", swap("studio.mmwave.json", old, new))
        for old, new in (
            ('"numAdcSamples": 64', '"numAdcSamples": "many"'),
            ('"numAdcSamples": 64', '"numAdcSamples": []'),
            ('"startFreqConst_GHz": 77.0', '"startFreqConst_GHz": []'),
            ('"rxChannelEn": "0xF"', '"rxChannelEn": "all"'),
            ('"b2AdcBits": 2', '"b2AdcBits": 0'),
            ('"mmWaveDevices"', '"devices"'),
        )
    ),
    *(
        bad(f"{RAW} --config studio.mmwave.json", swap("studio.mmwave.json", old, new), says=says)
        for old, new, says in (
            ('"numAdcSamples": 64', '"numAdcSamples": 0', "samples per chirp"),
            ('"numAdcSamples": 64', '"numAdcSamples": 1e300', "samples per chirp"),
            ('"numFrames": 36', '"numFrames": 35', "35 frames"),
        )
    ),
    *(
        bad(f"{RAW} --config {name}", put(name, text))
        for name, text in (
            ("a.cfg", ""),
            ("a.cfg", "profileCfg 0 77\n"),
            ("a.cfg", "profileCfg a b c d e f\n"),
            ("a.cfg", b"\xff\x00"),
            ("a.lua", "ar1.ProfileConfig(\n"),
            ("a.lua", ""),
            ("LogFile.txt", "API:ProfileConfig,"),
            ("LogFile.txt", ""),
            ("other.txt", "x"),
        )
    ),
    bad(UNPLACED + " --static --raster 6 6 1 1", says="--static"),
    bad(UNPLACED + " --raster 6 6 0.004", says="--raster"),
    bad(UNPLACED + " --raster 1000000 1000000 0.004 0.004", says="36"),
    bad(UNPLACED + " --raster 6 6 1e9 0.004", says="step"),
    bad(UNPLACED + " --raster 6 6 4 4", says="metres"),
    *(
        bad(UNPLACED + " --positions robot.csv", put("robot.csv", text))
        for text in (
            ROBOT + "0,0,0,0\n",
            ROBOT + "0,0,0,0\n0,0,0,0\n",
            ROBOT + "inf,0,0,0\n1,0,0,0\n",
            ROBOT + "0;0;0;0\n1;0;0;0\n",
            "t,a,b,c\n0,0,0,0\n1,0,0,0\n",
            ROBOT.replace("_m", "_mm_") + "0,0,0,0\n",
            "x_m,x_m,y_m,z_m\n0,0,0,0\n",
            ROBOT + "0,1e30,0,0\n9,1e30,0,0\n",
            ROBOT + "a" * 5000,
            "t,x,y,z,qw,qx,qy,qz\n0,0,0,0,2,0,0,0\n",
        )
    ),
    *(
        bad(UNPLACED + " --positions robot.npy", put("robot.npy", data))
        for data in (b"", b"\x93NUMPY\x01\x00", b"PK\x03\x04", b"\x80\x04K\x01.")
    ),
    bad(MAT, put("scan.mat", mat_file(signal=np.zeros((4, 8))))),
    bad(MAT, put("scan.mat", mat_file(signal=np.array([["text"]], dtype=object)))),
    bad(MAT, put("scan.mat", mat_file(signal=1j * np.ones((4, 8)), positions=np.ones((3, 3))))),
    bad(MAT, put("scan.mat", mat_file(signal=1j * np.ones((4, 8)), positions=np.ones((4, 2))))),
    bad(MAT, put("scan.mat", mat_file(x=1))),
    bad(
        MAT + " --max-memory 0.01",
        put("scan.mat", mat_file(signal=np.zeros((3000, 3000)))),
        says="--max-memory",
    ),
    bad(MAT, put("scan.mat", b"\x89HDF\r\n\x1a\n" + bytes(200))),
    *(bad(MAT, flip("scan.mat", place)) for place in (132, 160, 176)),
    bad(NORM, npz("norm.npz", "real", received_signals=lambda a: a.real)),
    bad(NORM, npz("norm.npz", "flat", received_signals=lambda a: a[0])),
    bad(NORM, npz("norm.npz", "one short", antenna_locations=lambda a: a[:-1])),
    bad(NORM, npz("norm.npz", "in cm", antenna_locations=lambda a: 100 * a), says="metres"),
    bad(
        NORM,
        npz("norm.npz", "1e30", antenna_locations=lambda a: 1e30 * a),
        says="antenna coordinates",
    ),
    bad(NORM, npz("norm.npz", "NaN signals", received_signals=set_at((0, "nan")))),
    bad(NORM, put("norm.npz", bomb((10**7, 10**5, 4)))),
    bad(NORM, put("norm.npz", bomb((1 << 62, 1 << 62, 4)))),
    bad(PLANAR, put("planar/scan.npy", bytes(4000)), says="scan.npy"),
    bad(PLANAR, cut("planar/scan.npy", 0.99), says="scan.npy"),
    bad(PLANAR, cut("planar/antenna_phase.txt"), says="antenna_phase"),
    bad(PLANAR, put("planar/antenna_phase.txt", "nan " * 81 + "\n" + "0 " * 81), says="antenna"),
    bad(PLANAR, drop("planar/scan.npy"), says="planar"),
]
