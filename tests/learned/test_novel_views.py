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
