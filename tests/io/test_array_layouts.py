"""Arrays of geraf2's own files, whose digests may fit all the same: type, shape and content."""

import numpy as np
import pytest

from geraf2.calibration.corrections import Corrections
from geraf2.calibration.leakage import Leakage
from geraf2.echoes.glint_set import Glints
from geraf2.errors import UserError
from geraf2.fields import SdfGrid
from geraf2.freespace.silhouettes import Silhouettes
from geraf2.pipeline.prior import read_prior, save_prior
from geraf2.report.run_report import stored_truth
from geraf2.report.view_layers import read_heat_map
from geraf2.scene import Grid, LosPrior, Wall
from helpers.glint_sets import glints_at
from helpers.shadows import shadows

WALL = Wall(size_m=(0.2, 0.2, 0.2), thickness_m=0.004, permittivity=1.6)
CUBE = Grid.cube((0.0, 0.0, 0.0), 0.02, 5)
BOX = LosPrior.from_box((0.2, 0.2, 0.2), walls=(WALL,))


def corrections():
    return Corrections(
        leakage=Leakage(basis=np.ones((32, 2), "c8"), operator=np.ones((32, 2), "c8")),
        channel_phases_rad=np.zeros(4),
        drift_coefficients_m=np.zeros((2, 3)),
        prior_to_capture=np.eye(4),
    )


def of_truth(path):
    np.savez(path, vertices=BOX.vertices, faces=BOX.faces, distances_m=np.zeros(8))


def of_image(path):
    np.savez(path, volume=np.ones((3, 4, 5)), origin_m=np.zeros(3), spacing_m=np.array(0.01))


FILES = {
    "glints": (glints_at(np.ones((4, 3)), np.ones((4, 3)), poses=np.arange(4)).save, Glints.load),
    "silhouettes": (shadows(np.ones((2, 5, 6)), [0, 1]).save, Silhouettes.load),
    "sdf": (SdfGrid(grid=CUBE, values=np.ones((5, 5, 5), np.float32)).save, SdfGrid.load),
    "calibration": (corrections().save, Corrections.load),
    "prior": (lambda path: save_prior(BOX, path), read_prior),
    "truth": (of_truth, stored_truth),
    "image": (of_image, read_heat_map),
}
CHANGES = {
    "missing": lambda _: None,
    "NaN": lambda a: np.full(a.shape, np.nan),
    "infinite": lambda a: np.full(a.shape, -np.inf),
    "huge": lambda a: np.full(a.shape, 1e300),
    "one axis more": lambda a: a[None].repeat(3, axis=0),
    "of other axes": lambda _: np.ones((1, 3, 7, 2)),
    "text": lambda _: np.array(["x"]),
    "times": lambda a: np.zeros(a.shape, "M8[s]"),
    "records": lambda a: np.zeros(a.shape, [("a", "f8")]),
    "2^62": lambda a: np.full(a.shape, 2**62),
    "objects": lambda _: np.array([{"a": 1}], dtype=object),
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", FILES)
@pytest.mark.filterwarnings("error")
def test_an_array_that_geraf2_does_not_write_is_refused(name, change, tmp_path):
    save, load = FILES[name]
    path = tmp_path / f"{name}.npz"
    save(path)
    load(path)
    with np.load(path) as stored:
        arrays = dict(stored)
    accepted = []
    for key, array in arrays.items():
        new = CHANGES[change](array)
        others = {k: v for k, v in arrays.items() if k != key}
        np.savez(path, **others, **({} if new is None else {key: new}))
        try:
            load(path)
        except UserError:
            continue
        accepted.append(key)
    assert accepted == []


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("truth", "faces", -BOX.faces),
        ("truth", "faces", BOX.faces + 1),
        ("prior", "faces", BOX.faces[:0]),
        ("prior", "walls", np.full((1, 8), -1.0)),
        ("calibration", "leakage_operator", np.zeros((0, 0), np.complex64)),
        ("image", "spacing_m", np.array(-0.01)),
        ("image", "volume", np.ones((0, 4, 5))),
        ("sdf", "spacing_m", np.array(0.0)),
        ("silhouettes", "thresholds", np.ones(3)),
        ("glints", "poses", np.zeros(4)),
    ],
)
def test_contents_that_cannot_be_are_refused(name, key, value, tmp_path):
    save, load = FILES[name]
    path = tmp_path / f"{name}.npz"
    save(path)
    with np.load(path) as stored:
        arrays = dict(stored)
    np.savez(path, **{**arrays, key: value})
    with pytest.raises(UserError, match=str(path)):
        load(path)
