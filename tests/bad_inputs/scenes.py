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
    numbers,
    put,
    rows,
    set_at,
    swap,
    toml,
    values,
)

TOML, GROUP, AXES = "scene/scene.toml", "scene/radar.zarr/zarr.json", "scene/radar.zarr/axes"
IMAGE = "image scene out --every 4 --spacing-m 0.02"


def attribute(text, **new):
    """Attributes of the scene's group; `...` takes one away."""

    def apply(file):
        content = json.loads(file.read_text())
        content["attributes"].update(new)
        content["attributes"] = {k: v for k, v in content["attributes"].items() if v is not ...}
        file.write_text(json.dumps(content))

    return Change(GROUP, str(new)[:60], apply), text


def about(array, **new):
    """Metadata of an array."""
    return values(f"{array}/zarr.json", **new), array.split("/")[-1]


def floats(array, pose, how, change):
    """Other positions, axes or samples of a pose."""
    dtype = "<f4" if array == SIGNAL else "<f8"
    return numbers(f"{array}/c/{pose}/0/0", dtype, how, change)


def counts(how, *pair):
    return numbers("scene/radar.zarr/antenna_count/c/0", "<i8", how, set_at(pair))


def chunk(array, pose=0):
    return f"{array}/c/{pose}/0/0"


ROWS = [
    *keys(
        "info scene",
        TOML,
        """
        version 2 "one"
        unit "mm" 3
        frame "" 7
        typo 3
        waveform.start_frequency_hz 77 nan "77e9" true [77e9]
        waveform.chirp_slope_hz_per_s inf
        waveform.n_samples 31 32.5 1000000000 "32"
        walls.thickness_m 0 0.08
        walls.size_m [0.16,0.16]|"big"
        walls.center_m [nan,0,0]|
        calibration 3 [1]
        """,
    ),
    *rows(
        "info scene",
        put(TOML, "a = 1e9999999\n" * 3),
        cut(TOML),
        (swap(TOML, "frame", "fra\\u0000me"), "scene.toml"),
        (toml(TOML, "walls.center_m", "[0.4, 0, 0]"), "wall"),
        (toml(TOML, "walls.size_m", "[2, 2, 2]"), "wall"),
        (
            swap(
                TOML,
                "[[walls]]",
                "[[walls]]\nsize_m = [0.1, 0.1, 0.1]\nthickness_m = 0.004\npermittivity = 2\n"
                "[[walls]]",
            ),
            "outermost first",
        ),
        drop("scene/radar.zarr"),
        (drop(GROUP), "radar.zarr"),
        (values(GROUP, zarr_format=9), "radar.zarr"),
        drop(SIGNAL),
        (values(f"{SIGNAL}/zarr.json", shape=[4, 1 << 40, 32]), "radar.zarr"),
        *(
            about(SIGNAL, shape=shape)
            for shape in ([4, -1, 32], [4, 256], [], "all", [4.5, 256, 32])
        ),
        *(about(SIGNAL, data_type=name) for name in ("float64", "nonsense")),
        *(about(TX, data_type=name) for name in ("complex128", "bool")),
        about(SIGNAL, codecs=[{"name": "pickle"}]),
        about(SIGNAL, node_type="group"),
        about(SIGNAL, chunk_grid={"name": "other"}),
        about(SIGNAL, chunk_key_encoding={"name": "x"}),
        about(SIGNAL, fill_value="big"),
        about(AXES, data_type="int8"),
        about("scene/radar.zarr/antenna_count", shape=[1 << 40]),
        attribute("pose_names", pose_names=7),
        attribute("checksums", checksums=7),
        attribute("signal", checksums={"signal": ["0"] * 4}),
        (cut(chunk(SIGNAL)), "signal"),
        (flip(chunk(SIGNAL, 3), 0), "signal"),
        (put(chunk(RX, 1), bytes(99)), "rx_positions"),
        (folder(chunk(SIGNAL, 1)), "signal"),
        (floats(SIGNAL, 2, "NaN", set_at((9, "nan"))), "NaN"),
        (floats(TX, 0, "1e30", set_at((0, 1e30))), "1e+30"),
        (floats(TX, 2, "in mm", lambda a: 1000 * a), "transmitter"),
        (floats(RX, 3, "-inf", set_at((1, "-inf"))), "infinite"),
        (*(floats(a, 1, "moved 0", lambda a: a + 300.0) for a in (TX, RX)), "metres"),
    ),
    *rows(
        "info scene --verify",
        (flip(chunk(RX, 1), 1001), "rx_positions"),
        (flip(chunk(TX), 7), "tx_positions"),
        attribute("angle", checksums={"angle": ["0"] * 4}),
    ),
    *(bad(line, floats(SIGNAL, 0, "NaN", set_at((5, "nan"))), text="NaN") for line in (RUN, IMAGE)),
    *rows(
        RUN,
        (toml(TOML, "walls.size_m", "[2, 2, 2]"), "wall"),
        (flip(chunk(SIGNAL, 2), -1), "signal"),
        (flip(chunk(RX, 2), 3), "rx_positions"),
        (floats(TX, 0, "NaN", set_at((0, "nan"))), "NaN"),
        (floats(TX, 0, "1e30", set_at((0, 1e30))), "1e+30"),
        (floats(AXES, 0, "NaN", set_at((0, "nan"))), "axes"),
        (floats(AXES, 0, "x 2", lambda a: 2 * a), "axes"),
        (floats(TX, 2, "in mm", lambda a: 1000 * a), "transmitter"),
        (*(floats(a, 1, "moved 2", lambda a: 0.05 * a) for a in (TX, RX)), "within the outer wall"),
        (counts("-1", 0, -1), "antenna_count"),
        (counts("0", 0, 0), "0 antennas"),
    ),
    bad(IMAGE, flip(chunk(TX, 1), 100), text="tx_positions"),
    bad("calibrate scene --box 0.16 0.16 0.16", flip(chunk(AXES, 1), 4), text="axes"),
    bad(RUN + " --hold-out 17.5", text="17.5"),
]
