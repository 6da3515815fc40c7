"""Second half of the table, written after the first was mended."""

import io
import json
import struct
import zipfile

import numpy as np
from scipy.io import savemat

from bad_inputs.first import (
    IMPORT,
    PLACES,
    RAW,
    RUN,
    RX,
    SIGNAL,
    TX,
)
from bad_inputs.second_specs import SPECS
from bad_inputs.table import (
    Change,
    bad,
    cut,
    drop,
    flip,
    folder,
    keys,
    link,
    npy,
    npz,
    numbers,
    put,
    set_at,
    swap,
    sweep,
    toml,
    values,
)

# More of a constant than any machine holds, and what is no number.
CONSTANTS = [
    *sweep(
        RUN + " {}",
        """
        fit.max-voxels 1e6 999 99999999999
        fit.position-power -1 1000 nan
        fit.normal-power nan -0.1
        fit.more-weight -1 inf
        fit.outside-weight -1 nan
        fit.outside-distance-m 0 nan -1
        fit.distance-band-m 0 nan
        fit.cap-start-m -1 nan
        fit.cap-slope -1 nan
        fit.continuation-weight -1 inf
        fit.absence-reach-m -1 nan
        fit.absence-angle-rad 0 4 nan
        fit.absence-depth-m inf
        glints.wall-margin-m nan inf
        glints.neighbor-offset-m 0 nan
        glints.neighbor-angle-rad 0 7 nan
        glints.cluster-link-m 0 inf
        glints.range-correction-m nan inf
        glints.noise-margin-db nan inf
        glints.subaperture.direction-oversampling 0 1e9 nan
        glints.subaperture.rim-sizes-m nan|0|5
        max-memory 0 -1 nan much
        calibrate yes 1
        preset hybrid bestt Glint
        """,
    ),
    *sweep(
        RUN + " --preset best {}",
        """
        refine.max-contradicted -1 2
        refine.links.reach-m 0 nan
        refine.few-planes-voxel-scales 0 1e9
        refine.links.angle-rad 0 9
        refine.links.strong-db 0 nan
        refine.rim.dynamic-range-db 0 nan
        refine.silhouettes.max-tilt-deg 0 90
        refine.silhouettes.min-free 0 1 nan
        refine.fit.spacing-m 0 nan 1e-9
        heatmaps.withheld 0 0.9 nan
        heatmaps.rate-m 0 nan
        heatmaps.final-rate -1 2
        heatmaps.target-spacing-m 0 nan
        heatmaps.n-antennas 0
        """,
    ),
    *sweep(
        RUN + " --preset paper {}",
        """
        paper.lobe-power -1 nan
        paper.n-looks 0
        paper.n-clusters -1
        paper.bank 0 9
        paper.dark-scene 2 nan
        paper.charbonnier 0 nan
        paper.weight-decay -1 nan
        paper.reflectivity-n 1 100000
        paper.final-rate 2 -1
        paper.checkpoint-every 0
        paper.stage2.rsdf-weight -1 nan
        paper.field net
        paper.start middle
        """,
    ),
    *sweep(
        RUN + " --preset matched-filter {}",
        "matched-filter.spacing-m 0 1e-6 nan\nmatched-filter.threshold-scale 0 nan",
    ),
    *sweep(
        RUN + " --preset normal-field {}",
        "normal-field.spacing-m 0 nan\nnormal-field.level.n-levels 0\nnormal-field.weight-power -1",
    ),
    *sweep(
        RUN + " --preset back-projection {}",
        "back-projection.spacing-m 0 nan\nback-projection.dynamic-range-db 0 nan",
    ),
    *sweep(RUN + " --preset geraf1 {}", "level.reach-m 0 nan\nlevel.n-planes 0"),
    *sweep(
        "render run {}",
        """
        echo.wall-edge-m 0 1e-7 nan
        echo.stiffness 0 nan
        echo.n-planes 0
        n-draws -1 x
        spacing-m 5 -1
        threads 0 5000
        max-memory 1e-6
        """,
    ),
    *sweep("image scene out {}", "max-memory 1e-6\nspacing-m 2 5\nevery 0\nthreads 9999"),
    *sweep(
        "simulate spec.toml out {}", "max-memory 1e-6 0\nseed 99999999999999999999\nthreads 1e3"
    ),
    *sweep("import geraf-sens frames out {}", "phase-sign 0 x\nthreads 4097\nmax-memory"),
    *sweep(
        "los nerf out {}", "preset slow\ncamera-axes blender\nbounds 0 0 0 nan 1 1|\nhold-out x"
    ),
    *sweep("calibrate scene {}", "box 0 1 1|nan 1 1\ndelay-from ear\nautofocus.min-gain -1 nan"),
    *sweep("plan --depth 0.3 {}", "spacing 1e-9 20\naperture 0 0|11 1\nstandoff 1\nplanes 3"),
    *sweep("plan --box 11 1 1 {}", "box 0.2 0.2 -0.2|"),
    *sweep("evaluate run --truth truth.ply {}", "n-samples 1e4 10000001\nseed 1.5 nan"),
    *sweep("benchmark out --list {}", "jobs 5000\njobs 0.5"),
    *sweep("demo out {}", "glints.cluster-share 2\nseed x"),
    bad("reconstruct scene out --help-preset fats", says="fast"),
    bad("info scene --figure picture.docx", says="picture.docx"),
    bad("info scene --figure nowhere/a.png", says="nowhere"),
    bad("info raw/adc.bin --figure a.png", says="--figure"),
    bad("plan --depth 0.3 --figure a.png", says="--figure"),
    bad("doctor --threads 3", says="--threads"),
]

ATTRIBUTES = "scene/radar.zarr/zarr.json"


def attribute(**new):
    """Attributes of the scene's group; `...` takes one away."""

    def apply(file):
        content = json.loads(file.read_text())
        content["attributes"].update(new)
        content["attributes"] = {k: v for k, v in content["attributes"].items() if v is not ...}
        file.write_text(json.dumps(content))

    return Change(ATTRIBUTES, str(new)[:60], apply)


SCENES = [
    *keys(
        "info scene",
        "scene/scene.toml",
        """
        version 1.5 "1"
        unit "metre" ""
        waveform.start_frequency_hz true [77e9]
        waveform.n_samples "32" 33
        waveform.bandwidth_hz 4e9
        waveform.sample_rate_hz -625e3 inf
        walls.center_m [0,0]|[nan,0,0]|[1e9,0,0]
        walls.colour "red"
        walls.thickness_m 0.08 1000
        provenance.seed 3
        calibration 3 [1]
        """,
    ),
    bad("info scene", toml("scene/scene.toml", "walls.center_m", "[0.4, 0, 0]"), says="wall"),
    bad("info scene", toml("scene/scene.toml", "walls.size_m", "[2, 2, 2]"), says="wall"),
    bad(RUN, toml("scene/scene.toml", "walls.size_m", "[2, 2, 2]"), says="wall"),
    bad(
        "info scene",
        swap(
            "scene/scene.toml",
            "[[walls]]",
            "[[walls]]\nsize_m = [0.1, 0.1, 0.1]\nthickness_m = 0.004\npermittivity = 2\n[[walls]]",
        ),
        says="outermost first",
    ),
    bad("info scene", put("scene/scene.toml", "\x00"), says="scene.toml"),
    bad("info scene", put("scene/scene.toml", "a = 1e9999999\n" * 3), says="scene.toml"),
    bad("info scene", swap("scene/scene.toml", "frame", "fra\\u0000me"), says="scene.toml"),
    bad("info scene", link("scene/scene.toml", "nowhere"), says="scene"),
    bad("info scene", link("scene/scene.toml", "scene.toml"), says="scene"),
    bad("info scene", attribute(pose_names=...), says="pose_names"),
    bad("info scene", attribute(pose_names=["a"]), says="pose_names"),
    bad("info scene", attribute(pose_names=7), says="pose_names"),
    bad("info scene", attribute(checksums=7), says="checksums"),
    bad("info scene", attribute(checksums={"signal": []}), says="checksums"),
    bad("info scene", attribute(checksums={"other": ["0"] * 4}), says="checksums"),
    bad("info scene", attribute(checksums={"signal": ["0"] * 4}), says="signal"),
    bad("info scene --verify", attribute(checksums={"angle": ["0"] * 4}), says="angle"),
    *(
        bad(line, flip(f"{array}/c/{pose}/0/0", place), says=array.rsplit("/", 1)[1])
        for line, array, pose, place in (
            ("info scene", SIGNAL, 3, 0),
            ("info scene --verify", TX, 0, 7),
            (RUN, SIGNAL, 2, -1),
            (RUN, RX, 2, 3),
            ("image scene out --every 4 --spacing-m 0.02", TX, 1, 100),
            ("calibrate scene --box 0.16 0.16 0.16", "scene/radar.zarr/axes", 1, 4),
        )
    ),
    bad("info scene", drop(f"{SIGNAL}/c/1/0/0"), says="signal"),
    bad("info scene", put(f"{SIGNAL}/c/1/0/0", b""), says="signal"),
    bad("info scene", put(f"{RX}/c/1/0/0", bytes(99)), says="rx_positions"),
    bad("info scene", folder(f"{SIGNAL}/c/1/0/0"), says="signal"),
    bad("info scene", put(f"{SIGNAL}/zarr.json", b"\xff"), says="signal"),
    bad("info scene", put(f"{SIGNAL}/zarr.json", "[" * 100000), says="signal"),
    bad("info scene", drop("scene/radar.zarr/angle"), says="angle"),
    bad("info scene", drop("scene/radar.zarr/antenna_count"), says="antenna_count"),
    *(
        bad("info scene", values(f"scene/radar.zarr/{name}/zarr.json", **new), says=says)
        for name, new, says in (
            ("signal", {"shape": []}, "signal"),
            ("signal", {"shape": "all"}, "signal"),
            ("signal", {"shape": [4.5, 256, 32]}, "signal"),
            ("signal", {"node_type": "group"}, "signal"),
            ("signal", {"zarr_format": 2}, "signal"),
            ("signal", {"chunk_grid": {"name": "other"}}, "signal"),
            ("signal", {"chunk_key_encoding": {"name": "x"}}, "signal"),
            ("signal", {"fill_value": "big"}, "signal"),
            ("signal", {"codecs": [{"name": "pickle"}]}, "signal"),
            ("axes", {"shape": [4, 3]}, "axes"),
            ("axes", {"data_type": "int8"}, "axes"),
            ("angle", {"shape": [3]}, "angle"),
            ("angle", {"data_type": "float32"}, "angle"),
            ("antenna_count", {"data_type": "float64"}, "antenna_count"),
            ("antenna_count", {"shape": [1 << 40]}, "antenna_count"),
            ("rx_positions", {"shape": [4, 256, 2]}, "rx_positions"),
        )
    ),
    *(
        bad(line, numbers(f"{array}/c/{pose}/0/0", dtype, how, change), says=says)
        for line, array, pose, dtype, how, change, says in (
            (RUN, SIGNAL, 0, "<f4", "infinite", set_at((3, "inf")), "infinite"),
            ("info scene", SIGNAL, 2, "<f4", "NaN", set_at((9, "nan")), "NaN"),
            ("info scene", RX, 3, "<f8", "-inf", set_at((1, "-inf")), "infinite"),
            ("info scene", RX, 3, "<f8", "in mm", lambda a: 1e3 * a, "transmitter"),
            ("info scene", TX, 3, "<f8", "in cm", lambda a: 1e2 * a, "transmitter"),
            (RUN, RX, 0, "<f8", "-1e9", set_at((1, -1e9)), "1e+09"),
            (RUN, "scene/radar.zarr/axes", 1, "<f8", "skew", set_at((4, 0.5)), "axes"),
            (RUN, "scene/radar.zarr/axes", 3, "<f8", "inf", set_at((4, "inf")), "axes"),
        )
    ),
    *(
        bad(
            line,
            *(numbers(f"{a}/c/1/0/0", "<f8", f"moved {number}", shift) for a in (TX, RX)),
            says=says,
        )
        for number, (line, shift, says) in enumerate(
            (
                ("info scene", lambda a: a + 300.0, "metres"),
                ("info scene", lambda a: 0.0 * a, "within the outer wall"),
                (RUN, lambda a: 0.05 * a, "within the outer wall"),
            )
        )
    ),
]

CUBE = "v 0 0 0\nv {0} 0 0\nv 0 {0} 0\nv 0 0 {0}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
GLB = struct.pack("<4sII", b"glTF", 2, 9999) + struct.pack("<I4s", 8, b"JSON") + b"{}      "
MESHES = [
    bad("los a.obj out", put("a.obj", CUBE.format(160)), says="millimetres"),
    bad("los a.obj out --unit cm", put("a.obj", CUBE.format(9000)), says="90"),
    bad("los a.obj out", put("a.obj", CUBE.format("1e-40")), says="a.obj"),
    bad("los a.obj out", put("a.obj", CUBE.format(0)), says="a.obj"),
    bad("los a.obj out", put("a.obj", CUBE.format("inf"))),
    bad("los a.obj out", put("a.obj", CUBE.format("x"))),
    bad("los a.obj out", put("a.obj", "f 1 2 3\n")),
    bad("los a.obj out", put("a.obj", CUBE.format(1) + "f 1 2 99\n")),
    bad("los a.obj out", put("a.obj", CUBE.format(1) + "f 1 2 -99\n")),
    bad("los a.obj out", put("a.obj", b"\xff\xfe" + bytes(100))),
    bad("los a.stl out", put("a.stl", bytes(84))),
    bad("los a.stl out", put("a.stl", bytes(80) + b"\xff\xff\xff\xff" + bytes(50))),
    bad("los a.stl out", put("a.stl", bytes(80) + b"\x01\x00\x00\x00" + b"\xff" * 50)),
    bad("los a.stl out", put("a.stl", "solid\nfacet")),
    bad("los a.glb out", put("a.glb", b"glTF")),
    bad("los a.glb out", put("a.glb", GLB)),
    bad("los a.gltf out", put("a.gltf", "{}")),
    bad("los a.gltf out", put("a.gltf", "[" * 5000)),
    bad("los a.gltf out", put("a.gltf", '{"buffers":[{"uri":"/etc/passwd","byteLength":9}]}')),
    bad("los a.xyz out", put("a.xyz", "1 2 3"), says="a.xyz"),
    bad("los mesh out", put("mesh", "1 2 3"), says="mesh"),
    bad("reconstruct scene out --los a.obj", put("a.obj", CUBE.format(160)), says="metres"),
    bad("reconstruct scene out --los a.obj", put("a.obj", CUBE.format(0)), says="a.obj"),
    bad("reconstruct scene out --los box.ply", values("box.ply.json", unit="mm"), says="unit"),
    bad("calibrate scene --los box.ply", values("box.ply.json", unit="inch"), says="unit"),
    bad(
        "reconstruct scene out --los box.ply",
        values("box.ply.json", unit="cm\n\x1b[31m"),
        says="unit",
    ),
    bad("evaluate run --truth a.obj", put("a.obj", CUBE.format("nan"))),
    bad("evaluate run --truth a.obj", put("a.obj", "v 1 2 3\n")),
    bad("evaluate run --truth truth.ply", swap("truth.ply", "element face ", "element face 9")),
    bad("evaluate run --truth truth.ply", swap("truth.ply", "little", "middle")),
    bad("evaluate run --truth truth.ply", swap("truth.ply", "float x", "string x")),
    bad("evaluate run --truth truth.ply", swap("truth.ply", "end_header", "end_of_it")),
    bad("los 0.2x0.2 out", says="0.2x0.2"),
    bad("los 0.2xax0.2 out", says="0.2xax0.2"),
    bad("los 0.2x0.2x1e400 out", says="1e400"),
    bad("los 21x1x1 out", says="20 m"),
    bad("los 160x160x160 out", says="20 m"),
    *(
        bad("los box.ply out --to-radar m.json", put("m.json", text))
        for text in (
            "{}",
            "[1,2,3]",
            '[["a",0,0,0]]',
            "[[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]",
            "[" * 9999,
            "\x00",
            "",
        )
    ),
    bad("los box.ply out --to-radar scene", says="scene"),
]


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
IMPORTS = [
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
    bad(PLACES + " --static --raster 6 6 1 1", says="--static"),
    bad(PLACES + " --raster 6 6 0.004", says="--raster"),
    bad(PLACES + " --raster 1000000 1000000 0.004 0.004", says="36"),
    bad(PLACES + " --raster 6 6 1e9 0.004", says="step"),
    *(
        bad(PLACES + " --positions robot.csv", put("robot.csv", text))
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
        )
    ),
    *(
        bad(PLACES + " --positions robot.npy", put("robot.npy", data))
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

RECORDS = [
    *(
        bad("evaluate run --truth truth.ply", change)
        for change in (
            put("run/run.json", ""),
            put("run/run.json", "[" * 50000),
            values("run/run.json", scene="x"),
            values("run/run.json", stages=[]),
            folder("run/run.json"),
        )
    ),
    bad("evaluate run --truth truth.ply", values("run/run.json", format="x"), says="another"),
    bad("evaluate run --truth truth.ply", values("run/run.json", version="2"), says="another"),
    bad("evaluate run --truth truth.ply", cut("run/mesh_content.ply", 0.9), says="content.ply"),
    bad("evaluate run --truth truth.ply", put("run/mesh_content.ply", "ply"), says="content.ply"),
    bad("render run", flip("run/prior.npz", 70), says="prior.npz"),
    bad("render run", drop("run/prior.npz"), says="prior.npz"),
    bad("render run", put("run/config.toml", b"\xff"), says="config.toml"),
    *keys(
        "reconstruct scene out --config run/config.toml",
        "run/config.toml",
        """
        seed -1 1.5 "one"
        calibrate "maybe"
        box [1,2]|[nan,1,1]|"big"
        hold_out [nan]|3
        trust_los 1
        fit.max_voxels 0 1.5
        fit.cap_lean [0.2]|[2,3]
        glints.neighbor_count -1
        glints.subaperture.max_cosine 1.0 nan
        photos.mask_threshold 300 -1
        photos.preset "slow"
        photos.seed -2
        """,
    ),
]

PHOTOS = [
    *(
        bad(f"los {name} out --preset quick", change, says=says)
        for name, change, says in (
            ("nerf", values("nerf/transforms.json", frames=3), "transforms.json"),
            ("nerf", values("nerf/transforms.json", frames=[3]), "transforms.json"),
            ("nerf", values("nerf/transforms.json", frames=[{}]), "transforms.json"),
            ("nerf", values("nerf/transforms.json", camera_model="FISH"), "transforms.json"),
            ("nerf", values("nerf/transforms.json", cx="nan"), "cx"),
            ("nerf", values("nerf/transforms.json", k1=1e300), "nerf"),
            ("nerf", put("nerf/transforms.json", b"\xff"), "transforms.json"),
            ("nerf", link("nerf/images", "nowhere"), "nerf"),
            ("colmap", cut("colmap/sparse/0/cameras.bin"), "cameras.bin"),
            ("colmap", flip("colmap/sparse/0/images.bin", 7), "images.bin"),
            ("colmap", flip("colmap/sparse/0/cameras.bin", 7), "cameras.bin"),
            ("colmap", drop("colmap/images"), "images"),
            ("colmap", drop("colmap/sparse/0/images.bin"), "colmap"),
            ("colmap_text", put("colmap_text/sparse/0/cameras.txt", "1 PINHOLE a b"), "cameras"),
            ("colmap_text", put("colmap_text/sparse/0/images.txt", ""), "no photo"),
            ("neus", put("neus/cameras_sphere.npz", b""), "cameras_sphere"),
            ("neus", npz("neus/cameras_sphere.npz", "0", world_mat_0=lambda a: 0 * a), "world_mat"),
            ("llff", npy("llff/poses_bounds.npy", "short", lambda a: a[:2]), "bounds"),
            ("llff", put("llff/poses_bounds.npy", b"\x93NUMPY\x01\x00"), "bounds"),
            ("ring", put("ring/ring_par.txt", ""), "ring_par"),
            ("ring", put("ring/ring_par.txt", "-1\n"), "ring_par"),
            ("ring", put("ring/ring_par.txt", b"\xff\xff"), "ring_par"),
        )
    ),
    bad("los nerf out --masks nerf --mask-threshold 20", says="both"),
    bad("los nerf out --unit -1", says="--unit"),
    bad("los nerf out --bounds 0 0 0 0 1 1", says="--bounds"),
]

ROWS = [*CONSTANTS, *SCENES, *MESHES, *IMPORTS, *RECORDS, *SPECS, *PHOTOS]
