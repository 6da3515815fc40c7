"""The rows: of every reader one for each kind of fault, and of every command its own refusals."""

import io
import json
import struct

import numpy as np
from scipy.io import savemat

from bad_inputs.table import (
    bad,
    cut,
    drop,
    flip,
    holes,
    in_mm,
    keys,
    link,
    npy,
    npz,
    numbers,
    pipe,
    put,
    puts,
    rows,
    set_at,
    swap,
    sweep,
    table,
    toml,
    values,
)

BOX = "--box 0.16 0.16 0.16"
RUN = f"reconstruct scene out {BOX} --no-report --calibrate no --preset fast"
IMPORT = "import geraf-sens frames out"
UNPLACED = "import dca1000 raw/adc.bin out --radar radar.toml"
RAW = UNPLACED + " --raster 6 6 0.004 0.004"
EVALUATE = "evaluate run --truth truth.ply"
SIMULATE = "simulate spec.toml out"
PLAN = "plan --box 0.2 0.2 0.2"
STUDIO, TOML, ZARR = "studio.mmwave.json", "scene/scene.toml", "scene/radar.zarr"
SIGNAL, TX, RX, AXES = (f"{ZARR}/{n}" for n in ("signal", "tx_positions", "rx_positions", "axes"))

COMMANDS = [
    *(
        bad(line, text=text)
        for line, text in table("""
            reconstrukt scene out|reconstruct
            reconstruct|SCENE
            batch scene|OUT
            reconstruct scene out --box 0.16 0.16 0.16 --los box.ply|both
            reconstruct scene out --box 0.16 0.16 0.16 --nonsense 3|--nonsense
            reconstruct scene out --help-preset fats|fast
            reconstruct scene other --box 0.16 0.16 0.16|other
            reconstruct scene out --box 160 160 160|metres
            reconstruct scene out --box 0.16 0.16 0.16 --hold-out 0 360|named twice
            reconstruct scene out --los nowhere|nowhere
            import nothing frames out|geraf-sens
            import geraf-sens empty out|empty
            import mat empty out|empty
            import dca1000 empty out|empty
            import geraf-sens frames other|other
            import dca1000 raw/adc.bin out --radar radar.toml|--raster
            import dca1000 raw/adc.bin out --radar radar.toml --raster 6 6 0 0|row_step_m
            import dca1000 raw/adc.bin out --radar radar.toml --raster 6 6 4 4|metres
            import dca1000 raw/adc.bin out --radar radar.toml --static --raster 6 6 1 1|--static
            info nowhere|nowhere
            info memory://a/../b|goes down only
            info scene --figure picture.docx|picture.docx
            info raw/adc.bin --config nowhere.json|nowhere.json
            image scene out --spacing-m 2e-5|the volume would have
            image scene out --depth-m 0.3 0.5|add --plane
            image scene out --spacing-m 0.001 --max-memory 0.1|GiB of --max-memory
            reconstruct scene out --box 0.16 0.16 0.16 --max-memory 0.1|GiB of --max-memory
            simulate scene out|scene
            live nowhere out --idle 0.2|no plane came
            live scene run|is no session
            calibrate scene --box 0.16 0.16 0.16 --no-delay --delay-search -0.1 0.1|--delay-search
            los spec.toml out|spec.toml
            los box.ply out --unit furlong|--unit
            los 0.2xax0.2 out|0.2xax0.2
            render run --angles 12.5|12.5
            evaluate run --truth scene|scene
            view run --host=|--host
            export run no/m.stl|the folder of the file does not exist
            plan --box 220 220 220|--box must be at most 10
            plan --box 0.2 0.2 0.2 --radar radar.toml --preset awr1843|both
            reconstruct scene out --box 0.16 0.16 0.16 --hold-out 17|no plane at 17 degrees
            reconstruct scene out --box 0.16 0.16 0.16 --resume|got best
            reconstruct scene out --box 0.16 0.16 0.16 --resume --preset matched-filter|paper
            reconstruct scene out --preset matched-filter --samples 4|states no errors
            plan --box 0.001 0.2 0.2|at least 0.042 m
            plan --box 0.001 0.2 0.2 --minutes 5|--box: the box is too small
            plan --box 0.001 0.2 0.2 --figure plan.html|.png
            plan --box 0.2 0.2 0.2 --minutes 0.01|no plan can be reached in the time
            plan --box 0.2 0.2 0.2 --minutes 5 --out scan.txt|ending in .json or .csv
            benchmark out --only nothing --list|nothing
            demo out --max-memory 1e-6|--max-memory
        """)
    ),
    bad("info " + "x" * 200_000, text="xxx"),
    # What the walk over the flags does not reach: bounds on each other, how many values there are.
    *sweep(RUN + " {}", "fit.spacing-m|0\nfit.cap-lean|-9 -9|0.2\npreset|hybrid"),
    *sweep(RUN + " --preset paper {}", "paper.grid-n|0 25\npaper.mesh-n|0|100000"),
    *sweep("image scene out --every 4 {}", "pose|99\nsize-m|nan 1 1\nangles-deg|60 0"),
    *sweep(
        PLAN + " {}",
        "aperture|0 0.1\nelevations-deg|90|10 10\ncontent|0.1 0|0 0.3\nspacing|1e-12\narray|nix",
    ),
    *sweep("plan --depth 0.3 {}", "aperture|11 1\nstandoff|1\nplanes|3\nfigure|a.png"),
    *sweep("render run {}", "echo.max-edge-m|1e-7\nspacing-m|5\nmax-memory|1e-6"),
    *sweep(f"calibrate scene {BOX} {{}}", "channels|1|0\ndelay-search|0.1 0"),
    *sweep("los 0.2x0.2x0.2 out {}", "box-center|nan 0 0\nbounds|1 1 1 0 0 0\nunit|mm"),
]
SPECS = [
    *keys(
        SIMULATE,
        "spec.toml",
        """figure.name|3
        figure.mesh|"no.ply"
        figure.typo|1
        scan.spacing_m|"3mm"
        scan.standoff_m|0.05
        scan.aperture_m|[0,0.1]
        walls.thickness_m|0.2
        world.effects|["leak"]|"iq" """,
    ),
    *keys(
        SIMULATE,
        "spec.toml",
        """belt.arrays|[]|[{side="front"}]|[{side="left"},{side="left"}]
        belt.arrays|[{side="left",tx_m=[[0.0,0.0]]}]|[{side="left",board="b"}]
        belt.speed|1.0""",
    ),
    bad(SIMULATE, toml("spec.toml", "waveform.n_samples", "1048576"), text="GHz"),
    bad(SIMULATE, toml("spec.toml", "figure.name", '"yeti"'), text="yeti"),
    *puts("benchmark out --suite a.toml --list", "a.toml", "", "scenes = 3"),
    bad("batch table.csv out", put("table.csv", "scene\n" + "x" * 200_000)),
]


def about(array, **new):
    """Metadata of an array of the scene."""
    return values(f"{array}/zarr.json", **new), array.split("/")[-1]


def floats(array, pose, change):
    """Other positions, axes or samples of a pose."""
    dtype = "<f4" if array == SIGNAL else "<f8"
    return numbers(f"{array}/c/{pose}/0/0", dtype, change)


WALL = "[[walls]]\nsize_m = [0.1, 0.1, 0.1]\nthickness_m = 0.004\npermittivity = 2\n[[walls]]"
SCENES = [
    *keys(
        "info scene",
        TOML,
        """version|2
        unit|"mm"|3
        frame|""
        typo|3
        waveform.start_frequency_hz|77|nan|"77e9"|true|[77e9]
        waveform.n_samples|31|32.5|1000000000
        walls.thickness_m|0|0.08
        walls.size_m|[0.16,0.16]|"big"
        calibration|[1]""",
    ),
    *rows(
        "info scene",
        cut(TOML),
        (swap(TOML, "[[walls]]", WALL), "outermost first"),
        drop(ZARR),
        (values(f"{ZARR}/zarr.json", zarr_format=9), "radar.zarr"),
        (values(f"{ZARR}/zarr.json", "attributes", pose_names=7), "pose_names"),
        (values(f"{ZARR}/zarr.json", "attributes", checksums=7), "checksums"),
        drop(SIGNAL),
        (values(f"{SIGNAL}/zarr.json", shape=[4, 1 << 40, 32]), "radar.zarr"),
        *(about(SIGNAL, shape=shape) for shape in ([4, -1, 32], [4, 256], "all")),
        *(about(SIGNAL, data_type=name) for name in ("float64", "nonsense")),
        *(about(SIGNAL, codecs=codecs) for codecs in ([{"name": "pickle"}], [], "bytes")),
        about(SIGNAL, chunk_grid={"name": "other"}),
        about(AXES, data_type="int8"),
        about(f"{ZARR}/antenna_count", shape=[1 << 40]),
        (cut(f"{SIGNAL}/c/0/0/0"), "signal"),
        (put(f"{RX}/c/1/0/0", bytes(99)), "rx_positions"),
        (floats(SIGNAL, 2, set_at(9, "nan")), "NaN"),
        (floats(TX, 0, set_at(0, 1e30)), "1e+30"),
        (floats(TX, 2, in_mm), "transmitter"),
        (*(floats(a, 1, lambda a: a + 300.0) for a in (TX, RX)), "metres"),
    ),
    bad("info scene", flip(f"{RX}/c/1/0/0", 1001), text="rx_positions"),
    bad("view scene", values(f"{SIGNAL}/zarr.json", zarr_format=2), text="signal"),
    *rows(
        RUN,
        (flip(f"{SIGNAL}/c/2/0/0", -2), "signal"),
        (floats(SIGNAL, 0, set_at(5, "nan")), "NaN"),
        (floats(AXES, 0, lambda a: 2 * a), "axes"),
        (*(floats(a, 1, lambda a: 0.05 * a) for a in (TX, RX)), "within the outer wall"),
        (numbers(f"{ZARR}/antenna_count/c/0", "<i8", set_at(0, -1)), "antenna_count"),
        (numbers(f"{ZARR}/antenna_count/c/0", "<i8", set_at(0, 0)), "0 antennas"),
    ),
]


def mat(**of):
    file = io.BytesIO()
    savemat(file, of, do_compression=True)
    return put("scan.mat", file.getvalue())


def bomb(shape):
    """An .npz whose arrays state more zeros than they hold."""
    file = io.BytesIO()
    np.savez(file, received_signals=np.zeros((9, 9, 9), complex), antenna_locations=np.zeros(9))
    old, new = (f"'shape': {of}, }}".encode() for of in ((9, 9, 9), shape))
    return put("norm.npz", file.getvalue().replace(old.ljust(len(new)), new))


FRAME, TWO, CAPTURE = "frames/mf/1_120_0", "frames/mf/2_240_0", "frames/capture.json"
FRAME_ROWS = ("tpos", "rpos", "adcr", "adci")
ROBOT = "time_s,x_m,y_m,z_m\n"
IMPORTERS = [
    *rows(
        IMPORT,
        drop(f"{FRAME}/tpos.npy"),
        put(f"{TWO}/tpos.npy", b"\x93NUMPY"),
        flip(f"{TWO}/tpos.npy", 12),
        (npy(f"{FRAME}/tpos.npy", in_mm), "transmitter"),
        (*(npy(f"{FRAME}/{name}.npy", in_mm) for name in ("tpos", "rpos")), "metres"),
        npy(f"{FRAME}/rpos.npy", set_at(3, "nan")),
        npy(f"{TWO}/tpos.npy", lambda a: a[:, :2]),
        (npy(f"{FRAME}/tpos.npy", lambda a: a[:-1]), "rpos.npy"),
        (*(npy(f"{FRAME}/{n}.npy", lambda a: a[:, :16]) for n in ("adcr", "adci")), "adcr.npy"),
        (*(npy(f"{FRAME}/{n}.npy", lambda a: a[:0]) for n in FRAME_ROWS), "frame has 0 antennas"),
        npy(f"{FRAME}/rotation.npy", lambda a: 2 * a),
        npy(f"{FRAME}/adcr.npy", lambda a: a.astype("i4")),
        (link(FRAME, "nowhere"), "1_120_0"),
        (values(CAPTURE, path_bais_m=0.15), "path_bais_m"),
        (values(CAPTURE, start_frequency_hz="77e9"), "frequency"),
        (values(CAPTURE, adc_sample_rate_hz=...), "sample_rate"),
        (values(CAPTURE, n_adc_samples=31), "n_samples"),
        (values(CAPTURE, box_size_m=[-0.2]), "size_m"),
        (values(CAPTURE, wall_thickness_m=0.2), "thickness_m"),
    ),
    *keys(
        IMPORT + " --radar radar.toml",
        "radar.toml",
        """path_bais_m|0.1
        walls|3
        antennas.axes|[[1,0,0],[0,1,0]]|[[1,0,0],[1,0,0],[1,0,0]]
        raw.n_tx|0|99
        arrays|3""",
    ),
    *keys(RAW, "radar.toml", 'n_samples|63\nraw.layout|"other"\nantennas.rx_offsets_m|[[1,2]]'),
    bad(RAW, toml("radar.toml", "raw.n_rx", "3"), text="receivers"),
    *puts(RAW, "raw/adc.bin", b"", bytes(7), bytes(40000)),
    bad(RAW, cut("raw/adc.bin", 0.97)),
    *puts(UNPLACED + " --positions robot.csv", "robot.csv", "", b"\x00\xff", ROBOT + "a" * 5000),
    *puts(
        UNPLACED + " --positions robot.csv",
        "robot.csv",
        ROBOT + "1,0,0,0\n0,0,0,0\n",
        ROBOT + "0,nan,0,0\n1,0,0,0\n",
        ROBOT + "0,1e30,0,0\n9,1e30,0,0\n",
        "t,a,b,c\n0,0,0,0\n1,0,0,0\n",
        "t,x,y,z,qw,qx,qy,qz\n0,0,0,0,2,0,0,0\n",
    ),
    *puts(
        UNPLACED + " --positions robot.npy", "robot.npy", b"\x93NUMPY\x01\x00", b"\x80\x04K\x01."
    ),
    *rows(
        f"{RAW} --config {STUDIO}",
        swap(STUDIO, '"numAdcSamples": 64', '"numAdcSamples": "many"'),
        (swap(STUDIO, '"numAdcSamples": 64', '"numAdcSamples": 1e300'), "samples per chirp"),
        swap(STUDIO, '"rxChannelEn": "0xF"', '"rxChannelEn": "all"'),
        swap(STUDIO, '"mmWaveDevices"', '"devices"'),
        (swap(STUDIO, '"numFrames": 36', '"numFrames": 35'), "35 frames"),
    ),
    *puts(RAW + " --config a.cfg", "a.cfg", "profileCfg 0 77\n", "profileCfg a b c d e f\n"),
    *puts(RAW + " --config a.lua", "a.lua", "ar1.ProfileConfig(\n", b"\xff\x00"),
    *puts(
        "import mat scan.mat out", "scan.mat", b"", b"MATLAB" * 40, b"\x89HDF\r\n\x1a\n" + b"0" * 99
    ),
    *rows(
        "import mat scan.mat out",
        *(cut("scan.mat", share) for share in (0.5, 0.999)),
        *(flip("scan.mat", position) for position in (128, 132, 144, 160, 176)),
        mat(signal=np.array([["text"]], dtype=object)),
        mat(signal=1j * np.ones((4, 8)), positions=np.ones((3, 3))),
    ),
    *rows(
        "import mmnorm norm.npz out",
        cut("norm.npz"),
        *(bomb(shape) for shape in ((10**7, 10**5, 4), (1 << 62, 1 << 62, 4))),
        npz("norm.npz", "received_signals", None),
        npz("norm.npz", "received_signals", lambda a: a.real),
        npz("norm.npz", "antenna_locations", lambda a: a[:-1]),
        (npz("norm.npz", "antenna_locations", in_mm), "metres"),
    ),
    *puts("import planar planar out", "planar/scan.npy", b"", bytes(4000)),
    *rows(
        "import planar planar out",
        cut("planar/scan.npy", 0.99),
        (drop("planar/scan.npy"), "planar"),
        (put("planar/antenna_phase.txt", "a b"), "antenna_phase"),
    ),
]

CUBE = "v 0 0 0\nv {0} 0 0\nv 0 {0} 0\nv 0 0 {0}\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
GLB = struct.pack("<4sII", b"glTF", 2, 9999) + struct.pack("<I4s", 8, b"JSON") + b"{}      "
ACCESSOR = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}


def gltf(uri="data:application/octet-stream;base64," + "A" * 48, **changes):
    """A triangle in glTF whose entries are replaced."""
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": 36, "uri": uri}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [ACCESSOR],
    }
    return put("m.gltf", json.dumps(content | changes))


MESHES = [
    *puts("los box.ply out", "box.ply", "", "ply\n"),
    *rows(
        "los box.ply out",
        cut("box.ply", 0.95),
        swap("box.ply", "element vertex 8", "element vertex 9999999"),
        swap("box.ply", "property float x", "property list x y"),
        swap("box.ply", "little", "middle"),
        (values("box.ply.json", unit="cm\n\x1b[31m"), "unit"),
    ),
    bad("reconstruct scene out --los box.ply", cut("box.ply", 0.95)),
    bad(EVALUATE, swap("truth.ply", "element face ", "element face 9")),
    *puts("los a.obj out", "a.obj", *map(CUBE.format, ("0", "x", "nan", "1e30", "1/"))),
    bad("los a.obj out", put("a.obj", CUBE.format(220)), text="millimetres"),
    *puts(
        "los a.stl out", "a.stl", bytes(84), bytes(80) + b"\x09\0\0\0" + bytes(50), "solid facet"
    ),
    *puts("los a.glb out", "a.glb", b"glTF", GLB),
    *puts("los a.xyz out", "a.xyz", "1 2 3"),
    *rows(
        "los m.gltf out --unit m",
        (gltf(accessors=[{**ACCESSOR, "bufferView": 9}]), "m.gltf"),
        (gltf(accessors=[{"count": 500_000_000}]), "has no data"),
        (gltf(accessors=[{**ACCESSOR, "count": 500_000_000}]), "longer than its data"),
        (gltf(nodes=[{"mesh": 0}] * 200_000), "200000 objects"),
        (gltf(nodes=[{"mesh": 0}, {"children": [0, 0]}]), "two parents"),
        (gltf(extensionsRequired=["EXT_meshopt_compression"]), "needs EXT_meshopt_compression"),
        put("m.gltf", "[" * 100_000),
        (gltf("a.bin"), pipe("a.bin"), "a.bin"),
        (gltf("a.bin"), link("a.bin", "/dev/zero"), "outside"),
        (gltf("a.bin"), holes("a.bin"), "a.bin"),
        *((gltf(name), "outside") for name in ("../a.bin", "/dev/zero")),
    ),
    *puts(
        "los box.ply out --to-radar m.txt", "m.txt", "1 2 3", "2 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1"
    ),
    *puts("los box.ply out --to-radar m.json", "m.json", "{}", '[["a",0,0,0]]', "[" * 9999),
]


def number(name, value):
    """A number of a stage in run.json."""
    return values("run/run.json", "stages", "mesh", "numbers", **{name: value}), name


RUNS = [
    *rows(
        "verify run",
        *(number("n_glints", value) for value in ("x", [], None)),
        *(number("labels", value) for value in ([1], {"wall": "x"})),
        *(number("volume_95_percent_cm3", value) for value in ([1], [1, "x"])),
        *(number("extents_95_percent_mm", value) for value in ([[1, 2]], [[1], [1], [1]])),
        *(number("likely_ghosts", value) for value in ([1], [{}], [{"probability": "x"}])),
    ),
    *puts("render run", "run/config.toml", "preset = 'other'", "preset = fast", b"\xff"),
    *rows(
        "render run",
        (values("run/run.json", version=99), "99"),
        drop("run/config.toml"),
        drop("run/mesh_content.ply"),
        (toml("run/config.toml", "fit.max_voxels", "-1"), "max_voxels"),
        flip("run/prior.npz", 70),
    ),
    bad(EVALUATE, cut("run/mesh_content.ply", 0.9), text="content.ply"),
    bad(EVALUATE, values("run/run.json", format="x"), text="another"),
    *keys(
        "reconstruct scene out --config run/config.toml",
        "run/config.toml",
        'seed|1.5|"one"\nbox|[1,2]|"big"\nfit.spacing_m|nan|"fine"\nfit.unknown|1',
    ),
    # Of all arrays of our own files: tests/io/test_array_layouts.py.
    *rows("view run", npz("run/glints.npz", "poses", None), npz("run/sdf.npz", "values", None)),
]

# One reader of JSON and one of TOML serve all commands: every text meets the first file.
JSON = ('{"a":' * 60_000, '{"a": NaN}', '{"a": 1e999}', '{"a": -Infinity}', b'{"a": "\xff"}', "[]")
JSON += ('{"a": ' + "9" * 5000 + "}", "{}{}")
TOMLS = ("a = " + "[" * 5000, ".".join(["a"] * 40) + " = 1", "[" + ".".join("a" * 99_999) + "]")
TOMLS += (b"a = '\xff'", "a", "a = 1\na = 2")
RECORDS = """
verify run|run/run.json
inspect run|run/run.json
info raw/adc.bin --config studio.mmwave.json|studio.mmwave.json
los nerf out|nerf/transforms.json
info scene|scene/radar.zarr/signal/zarr.json
simulate spec.toml out|spec.toml
render run|run/config.toml
import dca1000 raw/adc.bin out --radar radar.toml|radar.toml
"""
"""Command lines that read a record, and its name."""
OTHERS = """
info scene|scene/radar.zarr/signal/c/1/0/0
import dca1000 raw/adc.bin out --radar radar.toml --positions robot.csv|robot.csv
batch scans.csv out|scans.csv
verify run|run/prior.npz
verify run|run/mesh_content.ply
los box.ply out --unit m|box.ply
import geraf-sens frames out|frames/mf/1_120_0/adcr.npy
import mat scan.mat out|scan.mat
import mmnorm norm.npz out|norm.npz
import planar planar out|planar/scan.npy
info raw/adc.bin --radar radar.toml|raw/adc.bin
"""
LINKS = f"""
info scene|{SIGNAL}/c/1/0/0|../../../../c/0/0/0
verify scene|scene/los.ply|../box.ply
calibrate scene out {BOX}|scene/photos/private.png|/etc/passwd
verify run|run/prior.npz|../norm.npz
{EVALUATE}|run/figures|../other
{EVALUATE}|run/metrics.json|../other/diary.txt
render run|run/views|../other
los box.ply out --unit m|out/training-1.safetensors|../other/diary.txt
inspect run|run/inspection.json|../other/diary.txt
"""
"""Links that lead out of a folder that came from elsewhere."""
FILES = [
    *puts(IMPORT, CAPTURE, *JSON),
    *puts("info scene", TOML, *TOMLS),
    *(bad(line, put(path, "[" * 100_000), text="") for line, path in table(RECORDS)),
    *(bad(line, pipe(path)) for line, path in table(RECORDS + OTHERS.strip())),
    *(bad(line, link(path, "/dev/zero")) for line, path in table(RECORDS)[:4]),
    *(bad(line, holes(path)) for line, path in table(RECORDS)[:4]),
    *(bad(line, link(path, to), text=f"{path}: is a link") for line, path, to in table(LINKS)),
    # A record may name any file below a link.
    bad(
        RUN.replace(" out ", " run ") + " --overwrite",
        link("run/notes", "../other"),
        values("run/run.json", files={"notes/diary.txt": ""}),
        text="run/notes: is a link",
    ),
    bad("los nerf out", *(pipe(f"nerf/images/photo{n}.png") for n in range(5)), text="photo"),
    bad("los nerf out", *(holes(f"nerf/images/photo{n}.png") for n in range(5)), text="none of"),
]

TABLES = {
    "command": COMMANDS,
    "spec": SPECS,
    "scene": SCENES,
    "importer": IMPORTERS,
    "mesh": MESHES,
    "run": RUNS,
    "file": FILES,
}
