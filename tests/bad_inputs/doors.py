"""What strangers send: files that unpack to any size, artefacts that fit no record, addresses."""

import json

import numpy as np

from bad_inputs import commands, flags, importers, meshes, photos, runs, scenes, specs
from bad_inputs.lines import IMPORT, RAW, RUN, UNPLACED
from bad_inputs.table import Change, bad, npz, put, values

EVALUATE = "evaluate run --truth truth.ply"
ZARR = "scene/radar.zarr"
JSON = (
    "[" * 100_000,
    '{"a":' * 60_000,
    '{"a": NaN}',
    '{"a": ' + "9" * 5000 + "}",
    b'{"a": "\xff"}',
    bytes(64),
    "[]",
    "3",
    "{}{}",
    "{'a': 1}",
)
# One reader of JSON and one of TOML serve all commands: every text meets the first files, some the
# others.
JSON_FILES = (
    (IMPORT, "frames/capture.json", JSON),
    ("verify run", "run/run.json", JSON[:1]),
    ("info scene", f"{ZARR}/signal/zarr.json", JSON),
    *((line, "run/run.json", JSON[:1]) for line in ("inspect run", "render run", "view run")),
    (EVALUATE, "run/run.json", JSON[:1]),
    ("info scene", f"{ZARR}/zarr.json", JSON[:3]),
    ("image scene out --every 4 --spacing-m 0.02", f"{ZARR}/zarr.json", JSON[:1]),
    ("info raw/adc.bin --config studio.mmwave.json", "studio.mmwave.json", JSON[:3]),
    ("los nerf out", "nerf/transforms.json", JSON[:3]),
)
TOML = (
    "a = " + "[" * 5000 + "]" * 5000,
    ".".join(["a"] * 40) + " = 1",
    "a = " + "9" * 5000,
    b"a = '\xff'",
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
    [
        {
            "name": "sharding_indexed",
            "configuration": {"chunk_shape": [1], "codecs": [BYTES], "index_codecs": [BYTES]},
        }
    ],
    [],
    "bytes",
)
NUMBERS = {
    "n_glints": ("x", [], 1.5, None),
    "labels": ("x", [1], {"wall": "x"}, {"wall": 1.5}),
    "applied": ("x", [3], {}, 1),
    "outlines": ("x", [], {}, 0.5),
    "volume_95_percent_cm3": ("x", [1], [1, "x"], [1, 2, 3], {}),
    "extents_95_percent_mm": ("x", [[1, 2]], [[1], [1], [1]], {}),
    "common_offset_sigma_mm": ("x", [], {}, None),
    "likely_ghosts": ("x", [1], {}, [{}], [{"probability": "x"}]),
}
SPOILED = {"NaN": lambda a: np.full(a.shape, np.nan), "missing": None}
RUN_ARRAYS = (
    ("view run", "glints", ("positions", "normals", "strengths", "position_sigma_m")),
    ("view run", "glints", ("normal_sigma_rad", "poses", "probability")),
    ("view run", "sdf", ("values", "origin_m", "spacing_m")),
    ("render run", "prior", ("vertices", "faces", "walls")),
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


def codec(number):
    path = f"{ZARR}/signal/zarr.json"
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
    (accessor(count=500_000_000), "longer than its data"),
    (gltf(nodes=[{"mesh": 0}] * 200_000), "200000 objects"),
    (gltf(nodes=[{"mesh": 0}, {"children": [0, 0]}]), "two parents"),
    (gltf(nodes=[{"mesh": 0}] + [{"children": [n, n]} for n in range(30)]), "two parents"),
    (gltf(buffers=[]), "m.gltf"),
    (gltf(accessors=[]), "m.gltf"),
    (accessor(count="x"), "m.gltf"),
    ("[" * 100_000, "m.gltf"),
)

_ROWS = [
    *(
        bad(line, put(path, text), text=path.split("/")[-2 if path.startswith(ZARR) else -1])
        for line, path, texts in JSON_FILES
        for text in texts
    ),
    *(bad(line, put(path, text)) for line, path, texts in TOML_FILES for text in texts),
    *(bad("info scene", codec(number), text="signal") for number in range(len(CODECS))),
    bad("view scene", values(f"{ZARR}/signal/zarr.json", zarr_format=2), text="signal"),
    *(
        bad("verify run", number(name, value), text=name)
        for name, wrong in NUMBERS.items()
        for value in wrong
    ),
    *(bad(EVALUATE, number("numbers", value), text="run.json") for value in ([], None)),
    bad("verify run", number("permittivity", 2.0), text="permittivity_sigma"),
    *(
        bad(line, npz(f"run/{file}.npz", f"{name} {how}", **{name: change}), text=f"{file}.npz")
        for line, file, names in RUN_ARRAYS
        for name in names
        for how, change in SPOILED.items()
    ),
    *(bad("los m.gltf out --unit m", put("m.gltf", content), text=text) for content, text in GLTF),
    *(bad(f"info {up}", text="goes down only") for up in UPWARDS),
    *(bad(line.format(UPWARDS[0]), text="goes down only") for line in READS_SCENE),
    *(
        bad(f"plan {flags}", text=text)
        for flags, text in (
            ("--box 1e-300 1 1", "--box"),
            ("--box 0.2 0.2 0.2 --array nix", "--array"),
            ("--box 0.2 0.2 0.2 --elevations-deg 10 10", "twice"),
            (f"--box 1 1 1 --elevations-deg {' '.join(map(str, range(40)))}", "40 elevations"),
        )
    ),
    bad(f"{UNPLACED} --raster 6 6 0 0", text="row_step_m"),
    bad(f"{UNPLACED} --raster 6 6 1e-9 0.004", text="row_step_m"),
    bad(f"{UNPLACED} --raster 6 6 0.004 0", text="column_step_m"),
    *(bad(f"los box.ply out --unit {unit}", text="--unit") for unit in ("furlong", "nan", "-1")),
    bad("los 0.2x0.2x0.2 out --unit mm", text="--unit"),
    *(
        bad(f"los box.ply out --bounds {corners}", text="--bounds")
        for corners in ("nan nan nan nan nan nan", "0 0 0 nan 1 1", "1 1 1 0 0 0", "0 0 0 0 1 1")
    ),
    bad("reconstruct scene out --box 0.16 0.16 0.16 --hold-out 0 360", text="named twice"),
    bad("render run --angles 90 0 90", text="named twice"),
    bad("batch scene out --box 1e-300 1 1", text="--box"),
    bad("batch table.csv out --list", put("table.csv", "scene\n" + "x" * 200_000)),
    bad("info " + "x" * 200_000, text="xxx"),
    bad("los " + "x" * 200_000 + " out", text="xxx"),
    bad("view run --host=", text="--host"),
    bad("export run no/m.stl", text="the folder of the file does not exist"),
    bad(
        "plan --box 0.2 0.2 0.2 --minutes 5 --out no/scan.json",
        text="the folder of the file does not exist",
    ),
    bad("plan --box 0.001 0.2 0.2", text="--box"),
    *(
        bad(f"{line} --max-memory 0.1", text="--max-memory")
        for line in (
            RUN,
            "image scene out --every 4",
            "image scene out --spacing-m 0.0005 --tiles --slab-gib 0.1",
        )
    ),
    bad("inspect run --max-memory 0.1", text="has no estimate of its memory"),
    bad("image scene out --spacing-m 0.0004 --max-memory 0.5", text="voxels"),
]

_KNOWN = {
    row.name
    for table in (commands, flags, importers, meshes, photos, runs, scenes, specs)
    for row in table.ROWS
}
ROWS = [row for row in _ROWS if row.name not in _KNOWN]
