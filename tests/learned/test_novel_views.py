import numpy as np
import pytest

from geraf2.learned.novel_views import psnr_db


def test_psnr_is_that_of_its_definition():
    measured = np.array([[0.0, 2.0], [1.0, 0.5]])
    rendered = measured + np.array([[0.1, -0.1], [0.1, 0.1]])
    assert psnr_db(rendered, measured) == pytest.approx(10 * np.log10(4.0 / 0.01))
    assert psnr_db(measured, measured) == float("inf")
    # The scale counts: nothing is fitted.
    assert psnr_db(0.5 * measured, measured) < psnr_db(0.9 * measured, measured)


def test_maps_that_cannot_be_compared_are_refused():
    with pytest.raises(ValueError, match="measured must be positive"):
        psnr_db(np.zeros((2, 2)), np.zeros((2, 2)))
    with pytest.raises(ValueError, match=r"rendered must have shape \(2, 2\), got \(4,\)"):
        psnr_db(np.zeros(4), np.ones((2, 2)))
