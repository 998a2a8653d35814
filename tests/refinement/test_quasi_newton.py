"""BFGS within bounds: the same minimum as SciPy's, and one step from a Hessian that is right."""

import numpy as np
import pytest
from scipy.optimize import minimize, rosen, rosen_der

from doo_ti.refinement.evidence import minimised

FREE = (np.full(3, -np.inf), np.full(3, np.inf))


@pytest.mark.parametrize("bounds", [FREE, (np.full(3, -2.0), np.array([0.8, 2.0, 2.0]))])
def test_the_minimum_is_that_of_scipy(bounds):
    x, hessian = minimised(lambda x: (rosen(x), rosen_der(x)), np.array([-0.5, 0.5, 0.5]), bounds, np.eye(3), 200, 1e-12)
    expected = minimize(rosen, [-0.5, 0.5, 0.5], jac=rosen_der, method="L-BFGS-B", bounds=list(zip(*bounds, strict=True)),
                        options={"ftol": 1e-14, "gtol": 1e-10})
    np.testing.assert_allclose(x, expected.x, atol=1e-4)
    np.linalg.cholesky(hessian)


def test_a_right_hessian_needs_one_step():
    matrix, calls = np.array([[3.0, 1.0], [1.0, 2.0]]), []

    def function(x):
        calls.append(x)
        return 0.5 * x @ matrix @ x, matrix @ x

    x, hessian = minimised(function, np.array([0.4, -0.7]), (np.full(2, -9.0), np.full(2, 9.0)), matrix, 20, 1e-6)
    np.testing.assert_allclose(x, 0.0, atol=1e-12)
    np.testing.assert_allclose(hessian, matrix, atol=1e-12)
    assert len(calls) == 2


def test_a_variable_at_its_bound_stays_where_the_function_falls_beyond():
    x, _ = minimised(lambda x: (x @ x, 2 * x), np.array([1.0, 1.0]), (np.array([1.0, -1.0]), np.full(2, 2.0)), np.eye(2), 20,
                     1e-9)
    np.testing.assert_allclose(x, [1.0, 0.0], atol=1e-4)


def test_a_hessian_that_is_far_too_flat_only_costs_steps():
    x, _ = minimised(lambda x: (x @ x, 2 * x), np.array([0.3, -0.6]), (np.full(2, -9.0), np.full(2, 9.0)), np.diag([1e-9, 2.0]),
                     30, 1e-9)
    np.testing.assert_allclose(x, 0.0, atol=1e-4)
