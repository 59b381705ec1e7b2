"""Deviations of slip forces, stiffness and normal force against scipy's integrals and closed forms."""

import numba as nb
import numpy as np
import pytest
from scipy import integrate, special, stats

from bayes_iwan.models import series
from bayes_iwan.models.kernels import sliders
from bayes_iwan.models.slip_force import FAMILIES, Gammas


@nb.njit
def _read(phi, table, top, shift, out):
    row = np.empty(table.size + 4)
    sliders._in_a_row(table, shift, row)
    for i in range(phi.size):
        out[i] = sliders._limited_mean(phi[i], row, 1.0 / top, shift)


def read(phi, table, top):
    """L(φ) as the sliders stage reads it from one draw's table."""
    out = np.empty_like(phi)
    _read(phi, table, top, 52 - int(np.log2(table.shape[0] // sliders.OCTAVES)), out)
    return out


def gamma_values(t, eta):
    return {"t1_N": np.array([t]), "eta1": np.array([eta]), "g1": np.array([1.0])}


def test_basis_is_orthonormal():
    x, w = np.polynomial.legendre.leggauss(40)
    basis = series.deviation_basis(6, 0.5 + 0.5 * x)
    np.testing.assert_allclose(basis * (0.5 * w) @ basis.T, np.eye(6), atol=1e-12)
    assert np.abs(basis @ (0.5 * w)).max() < 1e-12


@pytest.mark.parametrize("coefficients", [[0.4], [0.0, -0.6], [0.3, -0.5, 0.4, 0.2, -0.3, 0.1]])
@pytest.mark.parametrize("eta", [0.5, 2.0, 12.0])
def test_tilted_gamma_against_scipys_integral(eta, coefficients):
    law = stats.gamma(eta, scale=0.7)
    c = np.array([coefficients])
    p = np.linspace(0.0, 1.0, 200001)
    log_g = sum(
        a * np.sqrt(2 * k + 1) * special.eval_legendre(k, 2 * p - 1) for k, a in enumerate(coefficients, start=1)
    )
    below = integrate.cumulative_trapezoid(np.exp(log_g), p, initial=0.0)
    tables, top = Gammas(1).table(gamma_values(0.7, eta))
    deviating = series.deviating(tables, top, c)
    phi = top[0] * np.linspace(0.0, 1.0, 60001) ** 4
    survival = 1.0 - np.interp(law.cdf(phi), p, below / below[-1])
    truth = integrate.cumulative_trapezoid(survival, phi, initial=0.0)
    assert np.max(np.abs(read(phi, deviating[0], top[0]) - truth)) < 2e-5 * law.mean()


def test_below_the_lowest_node_the_table_begins_with_what_is_still_held(density_ratio):
    """The force that the table's first node starts with: the mean of the share held at zero and at the node, by φ."""
    values = {n: np.repeat(v, 3) for n, v in gamma_values(0.7, 0.15).items()}  # many elements slip early
    values["t1_N"] = np.array([0.4, 0.7, 1.3])
    tables, top = Gammas(1).table(values)
    c = np.array([[0.6, -0.4], [-0.5, 0.3], [0.2, 0.5]])
    deviating = series.deviating(tables, top, c)
    phi = top * 2.0**-sliders.OCTAVES
    for d in range(3):
        slipped = stats.gamma(0.15, scale=values["t1_N"][d]).cdf(phi[d])
        p = slipped * np.linspace(0.0, 1.0, 2001)
        held = 1.0 - integrate.trapezoid(density_ratio(c[d : d + 1], p)[0], p)
        assert held < 0.999, "else nothing is asked"
        assert deviating[d, 0, 0] == pytest.approx(tables[d, 0, 0] * (1.0 + held) / (2.0 - slipped), rel=1e-3)


def test_no_tilt_is_the_same_table_bit_for_bit_beside_a_tilted_draw():
    parameter_values = {n: np.repeat(v, 2) for n, v in gamma_values(0.7, 2.0).items()}
    tables, top = Gammas(1).table(parameter_values)
    deviating = series.deviating(tables, top, np.array([[0.0, 0.0], [0.3, 0.0]]))
    np.testing.assert_array_equal(deviating[0], tables[0])
    assert np.abs(deviating[1] - tables[1]).max() > 1e-3


def test_a_nonsense_draw_stays_nan_and_spoils_no_other():
    parameter_values = {"t1_N": np.array([np.nan, 0.7]), "eta1": np.array([2.0, 2.0]), "g1": np.ones(2)}
    tables, top = Gammas(1).table(parameter_values)
    deviating = series.deviating(tables, top, np.full((2, 3), 0.2))
    assert np.isnan(deviating[0]).any() and np.isfinite(deviating[1]).all()


@pytest.mark.parametrize("eta, share", [(0.5, 0.3), (2.0, 0.02), (2.0, 0.2), (9.0, 0.9)])
def test_slip_forces_with_a_limit_against_the_closed_form(eta, share):
    """E[min(Φ, φ)] up to the limit, and the mean of min(Φ, limit) beyond it."""
    law = stats.gamma(eta, scale=0.7)
    values = {n: np.repeat(v, 2) for n, v in gamma_values(0.7, eta).items()}
    tables, top = Gammas(1).table(values)
    limited = series.limited(tables, top, np.array([0.0, share]))
    np.testing.assert_array_equal(limited[0], tables[0])
    end = law.isf(share)
    phi = top[1] * np.linspace(0.0, 1.0, 4001)[1:] ** 3
    held = np.minimum(phi, end)
    truth = held * law.sf(held) + law.mean() * special.gammainc(eta + 1.0, held / 0.7)
    # the corner is rounded over the cell that holds it
    rounded = np.abs(phi - end) < 0.07 * end
    error = np.abs(read(phi, limited[1], top[1]) - truth)
    assert error[~rounded].max() < 1e-4 * end and error.max() < 0.02 * share * end


def test_a_limit_passes_nan_on():
    tables, top = Gammas(1).table({n: np.repeat(v, 3) for n, v in gamma_values(0.7, 2.0).items()})
    tables[0] = np.nan
    limited = series.limited(tables, top, np.array([0.2, np.nan, 0.2]))
    assert np.isnan(limited[0, :, 0]).all() and np.isnan(limited[1]).any() and np.isfinite(limited[2]).all()


@pytest.mark.parametrize("family", ["uniform", "power_law"])
def test_tilt_of_other_families_keeps_their_support_and_moves_the_mean(family, density_ratio):
    parameter_values = {
        "uniform": {"slip_mean_N": 1.2, "slip_width": 0.5},
        "power_law": {"slip_max_N": 2.0, "slip_chi": -0.3, "slip_end_share": 0.2},
    }[family]
    parameter_values = {n: np.array([v]) for n, v in parameter_values.items()}
    law = FAMILIES[family]
    tables, top = law.table(parameter_values)
    c = np.array([[0.5, -0.2]])
    deviating = series.deviating(tables, top, c)
    phi = np.linspace(0.0, top[0], 400001)
    p = np.linspace(0.0, 1.0, 100001)
    earlier = integrate.cumulative_trapezoid(density_ratio(c, p)[0], p, initial=0.0)
    above = np.interp(law.survival(phi, parameter_values)[0], 1.0 - p[::-1], (1.0 - earlier)[::-1])
    assert read(top.copy(), deviating[0], top[0])[0] == pytest.approx(integrate.trapezoid(above, phi), rel=2e-5)
    assert read(top.copy(), deviating[0], top[0])[0] > 1.05 * law.mean(parameter_values)[0]


def test_deviating_stiffness_has_the_elasticity_it_says():
    alpha = np.linspace(0.4, 1.9, 301)[None, None]
    k = 5.0 * alpha**0.3
    deviating = series.deviating_stiffness(k, alpha, np.full((1, 1, 1), 0.2), np.full((1, 1, 1), -0.5))
    slope = np.gradient(np.log(deviating[0, 0]), np.log(alpha[0, 0]))
    np.testing.assert_allclose(slope[1:-1], 0.5 - 0.5 * np.log(alpha[0, 0, 1:-1]), atol=1e-4)
    assert np.interp(1.0, alpha[0, 0], deviating[0, 0]) == pytest.approx(5.0, rel=1e-5)
    np.testing.assert_array_equal(series.deviating_stiffness(k, alpha, np.zeros((1, 1, 1)), np.zeros((1, 1, 1))), k)


def test_deviating_normal_force_multiplies_by_the_exponential_of_the_series():
    rng = np.random.default_rng(1)
    alpha, basis, c = rng.uniform(0.5, 2.0, (3, 2, 7)), rng.normal(size=(4, 1, 2, 7)), rng.normal(size=(3, 4))
    deviating = series.deviating_normal_force(alpha, basis, c)
    np.testing.assert_allclose(deviating[1, 1], alpha[1, 1] * np.exp(c[1] @ basis[:, 0, 1]), rtol=1e-12)
    np.testing.assert_array_equal(series.deviating_normal_force(alpha, basis, 0.0 * c), alpha)
