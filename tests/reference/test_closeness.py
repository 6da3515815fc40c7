import pytest
import torch

from reference.closeness import assert_close

LIMITS = {"element": 1e-2, "norm": 1e-3, "cosine": 1e-5, "bias": 1e-3}
WANT = torch.linspace(-1.0, 1.0, 1001, dtype=torch.float64)


def spoil(name):
    got = WANT.clone()
    if name == "element":
        got[500] += 0.02
    elif name == "norm":
        got *= 1.005
    elif name == "cosine":
        got += 4e-3 * torch.sin(1000.0 * WANT)
    elif name == "bias":
        got += 2e-3
    else:
        got[0] = torch.nan
    return got


def test_equal_arrays_pass():
    assert_close(WANT.clone(), WANT, **LIMITS)


@pytest.mark.parametrize("name", ["element", "norm", "cosine", "bias", "nan"])
def test_each_deviation_is_named(name):
    with pytest.raises(AssertionError, match="element" if name == "nan" else name):
        assert_close(spoil(name), WANT, **LIMITS)


def test_shapes_are_not_broadcast():
    with pytest.raises(AssertionError):
        assert_close(WANT[:, None], WANT, **LIMITS)
