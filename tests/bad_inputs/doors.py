"""What strangers send: files that unpack to any size, artefacts that fit no record, addresses."""

import json

import numpy as np

from bad_inputs import commands, flags, importers, meshes, photos, runs, scenes, specs
from bad_inputs.lines import IMPORT, RAW, RUN, UNPLACED
from bad_inputs.table import Change, bad, npz, put, values

EVALUATE = "evaluate run --truth truth.ply"
ZARR = "scene/radar.zarr"
ARRAYS = ("signal", "tx_positions", "rx_positions", "axes", "antenna_count", "angle")

JSON = (
    "[" * 100_000,
    '{"a":' * 60_000,
    '{"a": NaN}',
    '{"a": [-Infinity]}',
    '{"a": 1e999}',
    '{"a": ' + "9" * 5000 + "}",
    b'{"a": "\xff"}',
    "{}".encode("utf-16"),
    bytes(64),
    "[]",
    "3",
    '"x"',
    "{}{}",
    "{'a': 1}",
)
# One reader of JSON and one of TOML serve all commands: every text meets the first files, some the
# others.
JSON_FILES = (
    (IMPORT, "frames/capture.json", JSON),
    ("verify run", "run/run.json", JSON),
    ("info scene", f"{ZARR}/signal/zarr.json", JSON),
    *((line, "run/run.json", JSON[:1]) for line in ("inspect run", "render run", "view run")),
    (EVALUATE, "run/run.json", JSON[:1]),
    ("info scene", f"{ZARR}/zarr.json", JSON[:3]),
    *(("info scene", f"{ZARR}/{name}/zarr.json", JSON[:1]) for name in ARRAYS[1:]),
    ("image scene out --every 4 --spacing-m 0.02", f"{ZARR}/zarr.json", JSON[:1]),
    ("info raw/adc.bin --config studio.mmwave.json", "studio.mmwave.json", JSON[:3]),
    ("los nerf out", "nerf/transforms.json", JSON[:3]),
)
TOML = (
    "a = " + "[" * 5000 + "]" * 5000,
    "a = " + "{b = " * 200 + "1" + "}" * 200,
    "[" + ".".join(["a"] * 50_000) + "]",
    ".".join(["a"] * 40) + " = 1",
    "a = " + "9" * 5000,
    b"a = '\xff'",
    "a = 1".encode("utf-16"),
    bytes(64),
    "a",
    "[a]\n[a]",
    "a = 1\na = 2",
    "a = 1e",
)
TOML_FILES = (
    ("info scene", "scene/scene.toml", TOML),
    (RAW, "radar.toml", TOML[:1]),
    ("simulate spec.toml out", "spec.toml", TOML[:1]),
    ("render run", "run/config.toml", TOML[:1]),
    ("reconstruct scene out --config run/config.toml", "run/config.toml", TOML[:1]),
    ("benchmark out --suite suite.toml --list", "suite.toml", TOML[:1]),
    ("demo out --spec spec.toml", "spec.toml", TOML[:1]),
)
BYTES = {"name": "bytes", "configuration": {"endian": "little"}}
CODECS = (
    [BYTES, {"name": "zstd", "configuration": {"level": 0, "checksum": False}}],
    [BYTES, {"name": "gzip", "configuration": {"level": 5}}],
    [BYTES, {"name": "crc32c"}],
    [{"name": "transpose", "configuration": {"order": [0, 1, 2]}}, BYTES],
    [
        {
            "name": "sharding_indexed",
            "configuration": {"chunk_shape": [1], "codecs": [BYTES], "index_codecs": [BYTES]},
        }
    ],
    [{"name": "vlen-bytes"}],
    [],
    "bytes",
)
NUMBERS = {
    "n_glints": ("x", [], 1.5, None),
    "labels": ("x", [1], {"wall": "x"}, {"wall": 1.5}),
    "applied": ("x", [3], {}, 1),
    "left": ("x", [3], {}, 1),
    "outlines": ("x", [], {}, 0.5),
    "volume_95_percent_cm3": ("x", [1], [1, "x"], [1, 2, 3], {}),
    "extents_mm": ("x", [1, 2], [1, 2, "x"], {}),
    "extents_95_percent_mm": ("x", [[1, 2]], [[1], [1], [1]], {}),
    "common_offset_sigma_mm": ("x", [], {}, None),
    "likely_ghosts": ("x", [1], {}, [{}], [{"probability": "x"}]),
    "evidence_shares": ("x", [1], {"seen": "x"}),
    "n_back_faces": ("x", [], 0.5),
    "permittivity": ("x", [], {}),
    "thickness_m": ("x", [1], [1, 2, 3]),
}
SPOILED = {
    "NaN": lambda a: np.full(a.shape, np.nan),
    "1e300": lambda a: np.full(a.shape, 1e300),
    "an axis more": lambda a: a[None].repeat(3, axis=0),
    "text": lambda _: np.array(["x"]),
    "2^62": lambda a: np.full(a.shape, 2**62),
    "missing": None,
}
RUN_ARRAYS = (
    ("view run", "glints", ("positions", "normals", "strengths", "position_sigma_m")),
    ("view run", "glints", ("normal_sigma_rad", "poses", "probability")),
    ("view run", "sdf", ("values", "origin_m", "spacing_m")),
    ("render run", "prior", ("vertices", "faces", "walls")),
)
READS_MESH = (
    "reconstruct scene out --los m.gltf",
    "evaluate run --truth m.gltf",
    "inspect run --cad m.gltf",
    "calibrate scene --los m.gltf",
)
UPWARDS = ("file:///../..", "file://x/../y", "s3://bucket/../../x", "memory://a/../b")
READS_SCENE = (
    "image {} out --every 4 --spacing-m 0.02",
    "reconstruct {} out --box 0.16 0.16 0.16",
    "calibrate {} out --box 0.16 0.16 0.16",
    "reconstruct scene out --los {}/los.ply",
    "los {} out",
    "los {}/box.ply out --unit m",
)


def codec(array, number):
    path = f"{ZARR}/{array}/zarr.json"
    return Change(path, f"codecs {number}", values(path, codecs=CODECS[number]).apply)


def number(name, value):
    """A number of a stage in run.json, or all `numbers`."""

    def apply(file):
        content = json.loads(file.read_text())
        stage = content["stages"]["mesh"]
        (stage if name == "numbers" else stage["numbers"])[name] = value
        file.write_text(json.dumps(content))

    return Change("run/run.json", f"{name} = {value!r}", apply)


def gltf(**changes):
    """A triangle in glTF whose entries are replaced."""
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64," + "A" * 48}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    }
    return json.dumps(content | changes)


def accessor(**changes):
    one = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"} | changes
    return gltf(accessors=[{key: value for key, value in one.items() if value is not ...}])


GLTF = (
    (accessor(bufferView=..., count=500_000_000), "has no data"),
    (accessor(bufferView=..., count=20_000_000), "has no data"),
    (accessor(bufferView=...), "has no data"),
    (accessor(count=500_000_000), "longer than its data"),
    (accessor(type="MAT4"), "longer than its data"),
    (gltf(nodes=[{"mesh": 0}] * 200_000), "200000 objects"),
    (gltf(nodes=[{"mesh": 0}, {"children": [0, 0]}]), "two parents"),
    (gltf(nodes=[{"mesh": 0}] + [{"children": [n, n]} for n in range(30)]), "two parents"),
    (gltf(buffers=[]), "m.gltf"),
    (gltf(accessors=[]), "m.gltf"),
    (accessor(count=-3), "m.gltf"),
    (accessor(count="x"), "m.gltf"),
    ("[" * 100_000, "m.gltf"),
    ("{}", "m.gltf"),
)

_ROWS = [
    *(
        bad(line, put(path, text), says=path.split("/")[-2 if path.startswith(ZARR) else -1])
        for line, path, texts in JSON_FILES
        for text in texts
    ),
    *(bad(line, put(path, text)) for line, path, texts in TOML_FILES for text in texts),
    *(bad("info scene", codec("signal", number), says="signal") for number in range(len(CODECS))),
    *(bad("info scene", codec(name, 0), says=name) for name in ARRAYS[1:]),
    *(
        bad(line, values(f"{ZARR}/{name}/zarr.json", zarr_format=version), says=name)
        for line, name, version in (
            ("view scene", "signal", 2),
            *(("info scene --verify", name, 4) for name in ARRAYS),
        )
    ),
    *(
        bad("verify run", number(name, value), says=name)
        for name, wrong in NUMBERS.items()
        for value in wrong
    ),
    *(bad(EVALUATE, number("numbers", value), says="run.json") for value in ([], 3, "x", None)),
    bad("verify run", number("permittivity", 2.0), says="permittivity_sigma"),
    *(
        bad(line, npz(f"run/{file}.npz", f"{name} {how}", **{name: change}), says=f"{file}.npz")
        for line, file, names in RUN_ARRAYS
        for name in names
        for how, change in SPOILED.items()
        if name in ("positions", "faces") or how in ("NaN", "missing")
    ),
    *(bad("los m.gltf out --unit m", put("m.gltf", text), says=says) for text, says in GLTF),
    *(bad(line, put("m.gltf", GLTF[0][0]), says=GLTF[0][1]) for line in READS_MESH),
    *(bad(f"info {up}", says="goes down only") for up in UPWARDS),
    *(bad(line.format(UPWARDS[0]), says="goes down only") for line in READS_SCENE),
    *(
        bad(f"plan {flags}", says=says)
        for flags, says in (
            ("--box 1e-300 1 1", "--box"),
            ("--box 0.2 0.2 0.2 --array nix", "--array"),
            ("--array iwr1843 --depth 0.3", "--array"),
            ("--box 0.2 0.2 0.2 --elevations-deg 10 10", "twice"),
            (f"--box 1 1 1 --elevations-deg {' '.join(map(str, range(40)))}", "40 elevations"),
            ("--box 0.2 0.2 0.2 --planes 2000", "1000 planes"),
        )
    ),
    *(
        bad(f"{UNPLACED} --raster 6 6 {steps}", says=says)
        for says, all_steps in (
            ("row_step_m", ("0 0", "0 0.004", "1e-9 0.004")),
            ("column_step_m", ("0.004 0", "0.004 1e-12", "-0.004 0")),
        )
        for steps in all_steps
    ),
    *(
        bad(f"los {source} out --unit {unit}", says="--unit")
        for source in ("0.2x0.2x0.2", "box.ply", "nerf")
        for unit in ("furlong", "nan", "0", "-1", "inf")
    ),
    bad("los 0.2x0.2x0.2 out --unit mm", says="--unit"),
    *(
        bad(f"{line} {flag}bounds {corners}", says="--bounds")
        for line, flag in (
            ("los box.ply out", "--"),
            ("los 0.2x0.2x0.2 out", "--"),
            ("reconstruct scene out --box 0.16 0.16 0.16", "--photos."),
        )
        for corners in ("nan nan nan nan nan nan", "0 0 0 nan 1 1", "1 1 1 0 0 0", "0 0 0 0 1 1")
    ),
    *(
        bad(f"{line} {angles}", says="named twice")
        for line in ("reconstruct scene out --box 0.16 0.16 0.16 --hold-out", "render run --angles")
        for angles in ("0 0", "0 360", "90 0 90", "-270 90")
    ),
    *(
        bad(f"{line} 1e-300 1 1", says="--box")
        for line in (
            "reconstruct scene out --box",
            "calibrate scene --box",
            "batch scene out --box",
        )
    ),
    bad("batch table.csv out --list", put("table.csv", "scene\n" + "x" * 200_000)),
    bad("batch table.csv out --list", put("table.csv", "x" * 200_000 + "\nscene")),
    bad("info " + "x" * 200_000, says="xxx"),
    bad("los " + "x" * 200_000 + " out", says="xxx"),
    bad("view run --host=", says="--host"),
    bad("export run no/m.stl", says="the folder of the file does not exist"),
    bad(
        "plan --box 0.2 0.2 0.2 --minutes 5 --out no/scan.json",
        says="the folder of the file does not exist",
    ),
    bad("plan --box 0.001 0.2 0.2", says="--box"),
    *(
        bad(f"{line} --max-memory {gib}", says="--max-memory")
        for line in (
            RUN,
            "reconstruct scene out --box 0.16 0.16 0.16",
            "image scene out --every 4",
            "image scene out --spacing-m 0.0005 --tiles --slab-gib 0.1",
        )
        for gib in (1e-6, 0.1)
    ),
    *(
        bad(f"{line} --max-memory 0.1", says="has no estimate of its memory")
        for line in (
            "evaluate run --truth truth.ply",
            "los 0.2x0.2x0.2 out",
            "inspect run",
            "import mat scan.mat out",
            "calibrate scene out",
            "info scene",
            "batch scene out",
        )
    ),
    bad(RUN + " --fit.spacing-m 0.001 --max-memory 0.4", says="spacing-m"),
    bad("image scene out --spacing-m 0.0004 --max-memory 0.5", says="voxels"),
]

_KNOWN = {
    row.name
    for table in (commands, flags, importers, meshes, photos, runs, scenes, specs)
    for row in table.ROWS
}
ROWS = [row for row in _ROWS if row.name not in _KNOWN]
