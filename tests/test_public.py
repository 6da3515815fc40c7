"""The public face: every name is documented, and every example in it runs."""

import ast
import doctest
import inspect
import re
import textwrap

import numpy as np
import pytest
import trimesh

import geraf2
from geraf2.surfaces import FitConfig
from helpers.found_boxes import box_found_once  # noqa: F401 - a fixture of the tests here

NAMES = [name for name in geraf2.__all__ if name != "__version__"]
UNIT = re.compile(r"\[(1e-3 )?(m|Hz|rad|dB|degrees)\b|\(n_\w+,|\(n,|\bmetres\b|\b0 to 1\b")
ERROR = re.compile(r"(User|Value|Type)Error|\braises\b")


def _documentation(found) -> str:
    """Docstring, of a class with those of its fields and members."""
    if not isinstance(found, type):
        return inspect.getdoc(found) or ""
    texts = []
    for kind in (kind for kind in found.__mro__ if kind.__module__.startswith("geraf2.")):
        body = ast.walk(ast.parse(textwrap.dedent(inspect.getsource(kind))))
        values = [node.value for node in body if isinstance(node, ast.Expr)]
        texts += [v.value for v in values if isinstance(v, ast.Constant)]
    return "\n".join(map(str, texts))


def _describes(text: str, parameter: str) -> bool:
    return bool(re.search(rf"^\s*(\w+, )*{parameter}(, \w+)*(:|$)", text, flags=re.MULTILINE))


@pytest.mark.parametrize("name", NAMES)
def test_a_public_name_documents_units_shapes_and_errors(name):
    found = getattr(geraf2, name)
    text = _documentation(found)
    assert ">>> " in inspect.getdoc(found), "no example"
    assert UNIT.search(text), "neither a unit nor a shape"
    if not inspect.ismodule(found):
        assert ERROR.search(text), "no word on errors"
    if inspect.isfunction(found):
        assert "Return" in text, "no word on what comes back"
        parameters = inspect.signature(found).parameters
        assert [p for p in parameters if not _describes(text, p)] == []


@pytest.mark.parametrize("name", ["geraf2", *NAMES])
def test_the_examples_of_a_public_name_run(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # examples write files
    found = geraf2 if name == "geraf2" else getattr(geraf2, name)
    # As in NumPy's, `geraf2` and `np` are taken as imported.
    tests = doctest.DocTestFinder().find(found, name, globs={"geraf2": geraf2, "np": np})
    stated: list[str] = []
    results = [doctest.DocTestRunner(verbose=False).run(t, out=stated.append) for t in tests]
    assert sum(result.attempted for result in results) > 0
    assert sum(result.failed for result in results) == 0, "".join(stated)


def test_the_truth_may_be_an_object_of_trimesh():
    result, truth = geraf2.examples.small_run(), geraf2.examples.small_capture()[1]
    corners = np.arange(truth.faces.size).reshape(-1, 3)
    # The second as an STL file has it: every triangle with vertices of its own.
    scores = [
        geraf2.evaluate(result, trimesh.Trimesh(*mesh, process=False), n_samples=500, report=False)
        for mesh in ((truth.vertices, truth.faces), (truth.corners.reshape(-1, 3), corners))
    ]
    wanted = geraf2.evaluate(result, truth, n_samples=500, report=False)
    assert scores[0] == wanted
    assert scores[1].truth.is_watertight
    assert scores[1].truth.n_faces == wanted.truth.n_faces
    with pytest.raises(geraf2.UserError, match="the truth must be a mesh"):
        geraf2.evaluate(result, trimesh.PointCloud(truth.vertices), report=False)


def test_a_prior_without_walls_takes_those_of_the_capture():
    """`LosPrior.from_box` means what three side lengths mean."""
    capture, _ = geraf2.examples.small_capture()
    coarse = geraf2.FastPreset(fit=FitConfig(spacing_m=0.012))
    box = geraf2.LosPrior.from_box(geraf2.examples.BOX_M)
    result = geraf2.reconstruct(capture, box, coarse)
    assert result.prior.walls == geraf2.examples.small_run().prior.walls == capture.walls


def test_results_show_arrays_by_their_shape():
    run = geraf2.examples.small_run()
    text = repr(run.glints)
    assert f"{len(run.glints.positions)} x 3 float" in text
    assert len(text) < 1000
