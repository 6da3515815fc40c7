"""The box of a scan is found once: it is the longest step of the small scans of tests.

A process that meets the same scan, prior and options again gets the same FoundBox or error. Tests
of the search itself (tests/calibration) call it directly.
"""

import pytest

from geraf2.apps.photos import los
from geraf2.calibration.box_finder import find_box
from geraf2.errors import UserError
from geraf2.pipeline import box_check
from geraf2.pipeline.commands import calibrate
from geraf2.scene.store import capture_digest
from geraf2.scene.summary import is_delay_given

_FOUND = {}


def _known(prior):
    if prior is None:
        return None
    arrays = (prior.vertices, prior.faces, prior.certain)
    return (prior.walls, *(None if array is None else array.tobytes() for array in arrays))


def find_once(capture, *, expected=None, keep_delay=False, num_threads=None, summary=None):
    """As find_box."""
    about = (is_delay_given(capture), keep_delay, num_threads)
    key = (capture_digest(capture), *about, _known(expected))
    if key not in _FOUND:
        how = {"summary": summary, "keep_delay": keep_delay, "num_threads": num_threads}
        try:
            _FOUND[key] = find_box(capture, expected=expected, **how)
        except UserError as error:
            _FOUND[key] = error
    if isinstance(_FOUND[key], UserError):
        raise _FOUND[key].with_traceback(None)
    return _FOUND[key]


@pytest.fixture(scope="module", autouse=True)
def box_found_once():
    """For the conftest.py of a folder of tests, or for a module of them."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (box_check, calibrate, los):
            patch.setattr(module, "find_box", find_once)
        yield
