import numpy as np
import pytest
import scipy.sparse as sp

from geraf2.ops.grid_energy import GridEnergy
from reference import grid_energy as twin

SHAPES = [(5, 6, 4), (7, 2, 3), (2, 2, 2), (3, 9, 11)]
SPACING = (0.4, 0.5, 0.3)
TOLERANCE = {np.float32: 3e-6, np.float64: 1e-13}


def parts(shape, seed=0):
    rng = np.random.default_rng(seed)
    n = int(np.prod(shape))
    rows = sp.random(6, n, density=min(1.0, 8 / n), random_state=seed, format="csr")
    return (rows.T @ rows).tocsr(), rng.uniform(0.1, 1.0, n)


def energy(shape, dtype=np.float64, num_threads=1, bending=0.7):
    sparse, diagonal = parts(shape)
    made = GridEnergy(
        shape,
        SPACING,
        bending=bending,
        sparse=sparse,
        diagonal=diagonal,
        dtype=dtype,
        num_threads=num_threads,
    )
    return made, twin.matrix(shape, SPACING, bending, sparse.toarray(), diagonal)


@pytest.mark.usefixtures("simd")
@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512", None], indirect=True)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", SHAPES)
def test_product_and_diagonal_are_those_of_the_twin(shape, dtype):
    made, expected = energy(shape, dtype)
    field = np.random.default_rng(1).standard_normal(made.n_voxels).astype(dtype)
    product = made.apply(field)
    assert product.dtype == dtype
    size = np.abs(expected).max() * np.abs(field).max()
    np.testing.assert_allclose(product, expected @ field, atol=TOLERANCE[dtype] * size)
    np.testing.assert_allclose(made.diagonal(), np.diag(expected), rtol=TOLERANCE[dtype])


def test_bending_is_the_mean_squared_hessian_of_a_quadratic():
    shape = (5, 6, 4)
    x, y, z = (h * axis for h, axis in zip(SPACING, np.indices(shape), strict=True))
    hessian = np.array([[1.0, 0.3, -0.4], [0.3, -2.0, 0.7], [-0.4, 0.7, 0.5]])
    point = np.stack([x, y, z])
    field = 0.5 * np.einsum("i...,ij,j...->...", point, hessian, point).ravel() + 3.0 * x.ravel()
    n = field.size
    made = GridEnergy(
        shape, SPACING, bending=1.0, sparse=sp.csr_matrix((n, n)), diagonal=np.zeros(n)
    )
    assert field @ made.apply(field) == pytest.approx((hessian**2).sum())


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_smoothing_is_richardson_at_the_chebyshev_roots(degree, dtype):
    made, matrix = energy((5, 6, 4), dtype)
    rng = np.random.default_rng(3)
    right, field = rng.standard_normal((2, made.n_voxels)).astype(dtype)
    found = made.smooth(right, field, degree=degree, low=0.2, high=4.0)
    expected = twin.chebyshev(matrix, right, field, degree, 0.2, 4.0)
    size = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, atol=30 * TOLERANCE[dtype] * size)


def test_non_contiguous_fields_give_the_same():
    made, _ = energy((5, 6, 4))
    field = np.random.default_rng(5).standard_normal(2 * made.n_voxels)
    assert np.array_equal(made.apply(field[::2]), made.apply(field[::2].copy()))
