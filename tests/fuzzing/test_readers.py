"""Readers on data that a fuzzer found, on good files that were spoilt, and on nothing at all."""

import random
import warnings
from pathlib import Path

import pytest

from fuzzing import readers
from geraf2.errors import UserError

HERE = Path(__file__).parent
FOUND = sorted(path for path in HERE.glob("*/*/*") if path.parent.parent.name != "__pycache__")
N_SPOILT = 12


@pytest.fixture(scope="module", autouse=True)
def clean():
    yield
    readers.clean_up()


def read(name, data):
    """Anything but UserError fails; warnings of NumPy about odd numbers are no fault here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            readers.read(name, data)
        except UserError as error:
            return str(error)
    return ""


def spoilt(data, rng):
    """Data with a few bytes changed, moved, doubled or cut off, as mail and disks do."""
    data = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(1, len(data))
        change = rng.randrange(4)
        if change == 0:
            data[at] = rng.randrange(256)
        elif change == 1:
            del data[at : at + rng.randint(1, 8)]
        elif change == 2:
            data[at:at] = data[at : at + rng.randint(1, 16)]
        else:
            data[at] ^= 1 << rng.randrange(8)
        if len(data) < 3:
            break
    return bytes(data)


@pytest.mark.parametrize("path", FOUND, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_what_the_fuzzer_found_is_read_or_refused(path):
    assert path.stat().st_size < 10_000
    assert "\n" not in read(path.parent.name, path.read_bytes())


@pytest.mark.parametrize("name", readers.PARTS)
def test_spoilt_files_are_read_or_refused(name):
    rng = random.Random(name)
    good = list(readers.seeds(name))
    assert good
    for seed in good:
        read(name, seed[:1])
        for _ in range(max(1, N_SPOILT // len(good))):
            assert "\n" not in read(name, spoilt(seed, rng))
