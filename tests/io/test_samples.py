import numpy as np
import pytest

from geraf2.io.samples import NO_SAMPLE, complex_samples, conjugate_samples, stored_integers


@pytest.fixture
def integers():
    samples = np.random.default_rng(0).integers(-0x8000, 0x8000, (5, 7, 2), dtype=np.int16)
    samples[2, 3] = (NO_SAMPLE, 0x7FFF)
    samples[4, 6] = (0x7FFF, NO_SAMPLE)
    return samples


def test_the_conjugate_of_the_lowest_integer_does_not_wrap(integers):
    want = np.conj(complex_samples(stored_integers(integers)))
    got = conjugate_samples(integers.copy())
    assert got.dtype == np.int16
    assert np.array_equal(complex_samples(got), want)
    signal = complex_samples(integers)
    assert np.array_equal(conjugate_samples(signal), np.conj(signal))
