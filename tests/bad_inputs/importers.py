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
    keys,
    link,
    npy,
    npz,
    put,
    rows,
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
FRAME, TWO, CAPTURE = "frames/mf/1_120_0", "frames/mf/2_240_0", "frames/capture.json"
ROBOT = "time_s,x_m,y_m,z_m\n"


def edited(frame, name, how, change):
    return npy(f"{frame}/{name}.npy", how, change)


def mat(**arrays):
    return put("scan.mat", mat_file(**arrays))


ROWS = [
    *rows(
        IMPORT,
        *(drop(f"{FRAME}/{name}.npy") for name in ("tpos", "rotation")),
        put(f"{FRAME}/rpos.npy", b""),
        put(f"{TWO}/tpos.npy", b"\x93NUMPY"),
        *(cut(f"{FRAME}/{name}.npy") for name in ("tpos", "rotation")),
        flip(f"{TWO}/tpos.npy", 12),
        (edited(FRAME, "tpos", "in mm", lambda a: 1000 * a), "transmitter"),
        (*(edited(FRAME, n, "in mm", lambda a: 1000 * a) for n in ("tpos", "rpos")), "metres"),
        edited(FRAME, "rpos", "NaN", set_at((3, "nan"))),
        (edited(FRAME, "rpos", "1e30", set_at((3, 1e30))), "1e+30"),
        edited(TWO, "tpos", "2 columns", lambda a: a[:, :2]),
        edited(FRAME, "rotation", "x 2", lambda a: 2 * a),
        edited(FRAME, "adcr", "integers", lambda a: a.astype("i4")),
        *((link(FRAME, target), "1_120_0") for target in ("nowhere", "1_120_0")),
        (put("frames/mf/3_300_0", "a file"), "3_300_0"),
        link(f"{FRAME}/tpos.npy", "nowhere"),
        (values(CAPTURE, path_bais_m=0.15, path_bias_m=...), "path_bais_m"),
        (
            values(
                CAPTURE,
                box_size_m=[0.2, 0.3],
                wall_thickness_m=[0.004] * 2,
                wall_permittivity=[1.6, 1.6],
            ),
            "outermost first",
        ),
        *(
            (values(CAPTURE, **{key: value}), text)
            for key, value, text in (
                ("start_frequency_hz", 77.0, "start_frequency_hz"),
                ("start_frequency_hz", "77e9", "frequency"),
                ("adc_sample_rate_hz", ..., "sample_rate"),
                ("n_adc_samples", 31, "n_samples"),
                ("path_bias_m", 1e9, "path_bias_m"),
                ("path_bias_m", True, "path_bias_m"),
                ("box_size_m", "big", "box_size_m"),
                ("box_size_m", [-0.2], "size_m"),
                ("box_size_m", [[0.2, 0.2]], "size_m"),
                ("wall_thickness_m", [0.1, 0.2], "wall_thickness_m"),
                ("wall_thickness_m", 0.2, "thickness_m"),
            )
        ),
    ),
    *keys(
        IMPORT + " --radar radar.toml",
        "radar.toml",
        """
        path_bais_m 0.1
        walls 3
        antennas.axes [[1,0,0],[0,1,0]]|[[1,0,0]]
        raw.n_tx 0 99
        raw.offset_binary "yes" 1
        raw.start_time_s "noon"
        arrays 3
        """,
    ),
    *keys(
        RAW,
        "radar.toml",
        """
        start_frequency_hz nan
        chirp_slope_hz_per_s inf
        n_samples 63
        raw.layout "other"
        raw.frame_period_s 0
        antennas.rx_offsets_m []|[[1,2]]
        """,
    ),
    *rows(
        RAW,
        (toml("radar.toml", "raw.n_rx", "3"), "receivers"),
        *(put("raw/adc.bin", data) for data in (b"", bytes(7), bytes(40000))),
        *(cut("raw/adc.bin", share) for share in (0.97, 0.5)),
    ),
    bad(UNPLACED, text="--raster"),
    bad(UNPLACED + " --serpentine", text="--raster"),
    *(
        bad(f"{UNPLACED} {flags}", text=text)
        for flags, text in (
            ("--raster 0 6 1 1", "--raster"),
            ("--raster 6 6 nan 1", "--raster"),
            ("--raster 6 6 0.004", "--raster"),
            ("--raster 1000000 1000000 0.004 0.004", "36"),
            ("--raster 6 6 1e9 0.004", "step"),
            ("--raster 6 6 4 4", "metres"),
            ("--static --raster 6 6 1 1", "--static"),
            ("--positions nowhere.csv", "nowhere.csv"),
        )
    ),
    *rows(
        UNPLACED + " --positions robot.csv",
        *(
            put("robot.csv", text)
            for text in (
                "",
                b"\x00\xff",
                ROBOT,
                ROBOT + "0,0,0\n",
                ROBOT + "1,0,0,0\n0,0,0,0\n",
                ROBOT + "0,nan,0,0\n1,0,0,0\n",
                ROBOT + "0,0,0,0\n0,0,0,0\n",
                ROBOT + "inf,0,0,0\n1,0,0,0\n",
                "t,a,b,c\n0,0,0,0\n1,0,0,0\n",
                "x_m,x_m,y_m,z_m\n0,0,0,0\n",
                ROBOT + "0,1e30,0,0\n9,1e30,0,0\n",
                ROBOT + "a" * 5000,
                "t,x,y,z,qw,qx,qy,qz\n0,0,0,0,2,0,0,0\n",
            )
        ),
    ),
    *rows(
        UNPLACED + " --positions robot.npy",
        *(
            put("robot.npy", data)
            for data in (b"", b"\x93NUMPY\x01\x00", b"PK\x03\x04", b"\x80\x04K\x01.")
        ),
    ),
    bad("info raw/adc.bin --radar radar.toml", toml("radar.toml", "raw.n_rx", "0"), text="n_rx"),
    bad("info raw/adc.bin --config nowhere.json", text="nowhere.json"),
    *rows(
        "info raw/adc.bin --config studio.mmwave.json",
        *(put("studio.mmwave.json", text) for text in ("{", "[]")),
    ),
    *(
        bad(f"{RAW} --config studio.mmwave.json", swap("studio.mmwave.json", old, new), text=text)
        for old, new, text in (
            ('"numAdcSamples": 64', '"numAdcSamples": "many"', None),
            ('"numAdcSamples": 64', '"numAdcSamples": []', None),
            ('"startFreqConst_GHz": 77.0', '"startFreqConst_GHz": []', None),
            ('"rxChannelEn": "0xF"', '"rxChannelEn": "all"', None),
            ('"b2AdcBits": 2', '"b2AdcBits": 0', None),
            ('"mmWaveDevices"', '"devices"', None),
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
    *rows(
        MAT,
        *(put("scan.mat", b) for b in (b"", b"MATLAB" * 40, b"\x89HDF\r\n\x1a\n" + bytes(200))),
        *(cut("scan.mat", share) for share in (0.5, 0.999)),
        *(flip("scan.mat", position) for position in (128, 132, 144, 160, 176)),
        mat(signal=np.zeros((4, 8))),
        mat(signal=np.array([["text"]], dtype=object)),
        mat(signal=1j * np.ones((4, 8)), positions=np.ones((3, 3))),
        mat(signal=1j * np.ones((4, 8)), positions=np.ones((4, 2))),
        mat(x=1),
    ),
    *rows(
        NORM,
        cut("norm.npz"),
        put("norm.npz", b"PK\x03\x04" + bytes(50)),
        *(put("norm.npz", bomb(shape)) for shape in ((10**7, 10**5, 4), (1 << 62, 1 << 62, 4))),
        npz("norm.npz", "no signals", received_signals=None),
        npz("norm.npz", "real", received_signals=lambda a: a.real),
        npz("norm.npz", "flat", received_signals=lambda a: a[0]),
        npz("norm.npz", "NaN signals", received_signals=set_at((0, "nan"))),
        npz("norm.npz", "NaN", antenna_locations=set_at((0, "nan"))),
        npz("norm.npz", "one short", antenna_locations=lambda a: a[:-1]),
        (npz("norm.npz", "in mm", antenna_locations=lambda a: 1000 * a), "metres"),
        (npz("norm.npz", "in cm", antenna_locations=lambda a: 100 * a), "metres"),
        (npz("norm.npz", "1e30", antenna_locations=lambda a: 1e30 * a), "antenna coordinates"),
    ),
    *rows(
        PLANAR,
        *(cut("planar/scan.npy", share) for share in (0.5, 0.99)),
        *(put("planar/scan.npy", data) for data in (b"", bytes(4000))),
        flip("planar/scan.npy", 20),
        (drop("planar/scan.npy"), "planar"),
        (put("planar/antenna_phase.txt", "a b"), "antenna_phase"),
        (cut("planar/antenna_phase.txt"), "antenna_phase"),
        (put("planar/antenna_phase.txt", "nan " * 81 + "\n" + "0 " * 81), "antenna"),
    ),
]
