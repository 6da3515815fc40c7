"""Spoiled scenes: scene.toml, the arrays of radar.zarr and their checksums."""

import json

from bad_inputs.lines import RUN, RX, SIGNAL, TX
from bad_inputs.table import (
    Change,
    bad,
    cut,
    drop,
    flip,
    folder,
    keys,
    link,
    numbers,
    put,
    set_at,
    swap,
    toml,
    values,
)

ATTRIBUTES = "scene/radar.zarr/zarr.json"


def attribute(**new):
    """Attributes of the scene's group; `...` takes one away."""

    def apply(file):
        content = json.loads(file.read_text())
        content["attributes"].update(new)
        content["attributes"] = {k: v for k, v in content["attributes"].items() if v is not ...}
        file.write_text(json.dumps(content))

    return Change(ATTRIBUTES, str(new)[:60], apply)


ROWS = [
    *keys(
        "info scene",
        "scene/scene.toml",
        """
        version 2 "one" -1
        unit "mm" 3
        format "other"
        frame "" 7
        typo 3
        waveform.start_frequency_hz 77 0 nan "77e9"
        waveform.chirp_slope_hz_per_s -1 70.15 inf
        waveform.n_samples 0 31 32.5 1000000000
        waveform.sample_rate_hz 0 nan
        waveform.path_bias_m 1e6 nan
        walls.permittivity 0.5 nan -1
        walls.thickness_m 0 -1 nan
        walls.size_m [0.16,0.16]|[0,0.16,0.16]|"big"
        """,
    ),
    bad("info scene", put("scene/scene.toml", "")),
    bad("info scene", put("scene/scene.toml", b"\xff\xfe\x00")),
    bad("info scene", put("scene/scene.toml", "a = [" * 2000)),
    bad("info scene", cut("scene/scene.toml")),
    bad("info scene", drop("scene/scene.toml")),
    bad("info scene", folder("scene/scene.toml")),
    bad("info scene", drop("scene/radar.zarr")),
    bad("info scene", drop("scene/radar.zarr/zarr.json"), says="radar.zarr"),
    bad("info scene", put("scene/radar.zarr/zarr.json", "{}"), says="radar.zarr"),
    bad("info scene", values("scene/radar.zarr/zarr.json", zarr_format=9), says="radar.zarr"),
    bad("info scene", drop(SIGNAL)),
    bad("info scene", drop(f"{TX}/zarr.json"), says="tx_positions"),
    bad("info scene", put(f"{SIGNAL}/zarr.json", "[]"), says="signal"),
    bad("info scene", values(f"{SIGNAL}/zarr.json", shape=[4, -1, 32]), says="signal"),
    bad("info scene", values(f"{SIGNAL}/zarr.json", shape=[4, 256]), says="signal"),
    bad("info scene", values(f"{SIGNAL}/zarr.json", shape=[4, 1 << 40, 32]), says="radar.zarr"),
    bad("info scene", values(f"{SIGNAL}/zarr.json", data_type="float64"), says="signal"),
    bad("info scene", values(f"{SIGNAL}/zarr.json", data_type="nonsense"), says="signal"),
    bad("info scene", values(f"{TX}/zarr.json", data_type="complex128"), says="tx_positions"),
    bad("info scene", values(f"{TX}/zarr.json", data_type="bool"), says="tx_positions"),
    bad("info scene", values(f"{SIGNAL}/zarr.json", codecs=[]), says="signal"),
    bad(
        "info scene",
        values(f"{SIGNAL}/zarr.json", codecs=[{"name": "zstd", "configuration": {}}]),
        says="signal",
    ),
    bad("info scene", cut(f"{SIGNAL}/c/0/0/0"), says="signal"),
    bad("info scene", cut(f"{TX}/c/0/0/0"), says="tx_positions"),
    bad("info scene", flip(f"{SIGNAL}/c/1/0/0", 1000), says="signal"),
    bad("info scene --verify", flip(f"{RX}/c/1/0/0", 1001), says="rx_positions"),
    *(
        bad(f"{line}", numbers(f"{SIGNAL}/c/0/0/0", "<f4", "NaN", set_at((5, "nan"))), says="NaN")
        for line in ("info scene", RUN, "image scene out --every 4 --spacing-m 0.02")
    ),
    bad(RUN, numbers(f"{TX}/c/0/0/0", "<f8", "NaN", set_at((0, "nan"))), says="NaN"),
    bad(RUN, numbers(f"{TX}/c/0/0/0", "<f8", "1e30", set_at((0, 1e30))), says="1e+30"),
    bad("info scene", numbers(f"{TX}/c/0/0/0", "<f8", "1e30", set_at((0, 1e30))), says="1e+30"),
    bad(
        RUN, numbers("scene/radar.zarr/axes/c/0/0/0", "<f8", "NaN", set_at((0, "nan"))), says="axes"
    ),
    bad(RUN, numbers("scene/radar.zarr/axes/c/0/0/0", "<f8", "0", lambda a: 0 * a), says="axes"),
    bad(RUN, numbers("scene/radar.zarr/axes/c/0/0/0", "<f8", "x 2", lambda a: 2 * a), says="axes"),
    *(
        bad(line, numbers(f"{TX}/c/2/0/0", "<f8", "in mm", lambda a: 1000 * a), says=says)
        for line, says in ((RUN, "transmitter"), ("info scene", "transmitter"))
    ),
    bad(
        RUN,
        *(numbers(f"{p}/c/2/0/0", "<f8", "in mm", lambda a: 1000 * a) for p in (TX, RX)),
        says="metres",
    ),
    bad(
        RUN,
        numbers("scene/radar.zarr/antenna_count/c/0", "<i8", "-1", set_at((0, -1))),
        says="antenna_count",
    ),
    bad(
        RUN,
        numbers("scene/radar.zarr/antenna_count/c/0", "<i8", "big", set_at((0, 9999))),
        says="antenna_count",
    ),
    bad(
        RUN,
        numbers("scene/radar.zarr/antenna_count/c/0", "<i8", "0", set_at((0, 0))),
        says="0 antennas",
    ),
    bad(RUN + " --hold-out 17.5", says="17.5"),
    bad(RUN + " --fit.cap-lean 1 2 3", says="'3'"),
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
