"""Slip-force distributions against scipy: densities, survival, means, and the tables of L(φ) = E[min(Φ, φ)]."""

import numba as nb
import numpy as np
import pytest
from scipy import integrate

from bayes_iwan.models.kernels import sliders
from bayes_iwan.models.slip_force import ETA_MAX, ETA_MIN, FAMILIES, Gammas


@nb.njit
def _read(phi, table, top, shift, out):
    row = np.empty(table.size + 4)
    sliders._in_a_row(table, shift, row)
    for i in range(phi.size):
        out[i] = sliders._limited_mean(phi[i], row, 1.0 / top, shift)


def read(phi, table, top):
    """L(φ) as the sliders stage reads it from one draw's table."""
    cells_an_octave = table.shape[0] // sliders.OCTAVES
    out = np.empty_like(phi)
    _read(phi, table, top, 52 - int(np.log2(cells_an_octave)), out)
    return out


@pytest.mark.parametrize("family", FAMILIES)
def test_family_against_scipy(family, truth):
    parameter_values, survival = truth.family_cases[family]
    law = FAMILIES[family]
    assert set(law.names) == set(parameter_values) and len(law.units) == len(law.names)
    phi = np.linspace(0.0, 6.0, 4001)
    np.testing.assert_allclose(law.survival(phi, parameter_values)[0], survival(phi), atol=1e-12)
    limited = truth.limited_by_sum(survival, np.linspace(0.0, 30.0, 5))
    assert law.mean(parameter_values)[0] == pytest.approx(limited[-1], rel=3e-6)
    inside = phi[(phi > 0.01) & (phi < 1.9)]
    steps = np.diff(survival(inside)) / np.diff(inside)
    middle = 0.5 * (inside[1:] + inside[:-1])
    smooth = np.abs(np.gradient(steps)) < 1e-2  # but at a jump of the density
    np.testing.assert_allclose(law.density(middle, parameter_values)[0][smooth], -steps[smooth], atol=5e-3)


@pytest.mark.parametrize("family", FAMILIES)
def test_table_of_every_family(family, truth):
    parameter_values, survival = truth.family_cases[family]
    table, top = FAMILIES[family].table(parameter_values)
    phi = np.linspace(0.0, 1.3, 20001) * top[0]
    error = read(phi, table[0], top[0]) - truth.limited_by_sum(survival, phi)
    assert np.max(np.abs(error)) < 3e-6 * FAMILIES[family].mean(parameter_values)[0]
    assert read(np.array([0.0, np.nan]), table[0], top[0])[0] == 0.0
    assert np.isnan(read(np.array([0.0, np.nan]), table[0], top[0])[1])


@pytest.mark.parametrize("family", FAMILIES)
def test_no_slip_force_lies_beyond_a_family_s_support(family, truth):
    parameter_values, survival = truth.family_cases[family]
    beyond = np.array([phi for phi in (0.1, 2.01, 30.0) if survival(phi) in (0.0, 1.0) or phi == 30.0])
    np.testing.assert_allclose(FAMILIES[family].density(beyond, parameter_values), 0.0, atol=1e-12)


@pytest.mark.parametrize("family", ["uniform", "gaussian"])
def test_below_its_lowest_node_a_table_goes_on_to_zero(family, truth):
    """There all elements hold: L(φ) is φ."""
    parameter_values, _ = truth.family_cases[family]
    table, top = FAMILIES[family].table(parameter_values)
    phi = top[0] * 2.0**-sliders.OCTAVES * np.array([1.0, 0.5, 0.1, 1e-3])
    np.testing.assert_allclose(read(phi, table[0], top[0]), phi, rtol=1e-5)


@pytest.mark.parametrize("spread", ["shapes alike", "means 1:1000", "scales 1:1000"])
def test_gamma_tables_over_the_whole_prior_range(spread, truth):
    """η from 0.1 to 80, components that differ by three decades: L within 3e-5 of the mean (measured 1.5e-5)."""
    rng = np.random.default_rng(2)
    draws = 400
    eta = np.exp(rng.uniform(np.log(ETA_MIN), np.log(ETA_MAX), (draws, 3)))
    eta[0], eta[1], eta[2] = ETA_MIN, ETA_MAX, (ETA_MIN, 1.0, ETA_MAX)
    apart = np.exp(rng.uniform(0.0, np.log(1000.0), (draws, 3)))
    t = {"shapes alike": 1.0 + 0.0 * apart, "means 1:1000": apart / eta, "scales 1:1000": apart}[spread]
    g = rng.dirichlet([0.7, 0.7, 0.7], draws)
    table, top = Gammas(3).table(truth.gamma_values(t, eta, g))
    for d in range(draws):
        phi = np.geomspace(1e-9, 1.5, 1500) * top[d]
        error = read(phi, table[d], top[d]) - truth.gamma_limited(t[d], eta[d], g[d], phi)
        assert np.max(np.abs(error)) < 3e-5 * np.sum(g[d] * t[d] * eta[d]), (t[d], eta[d], g[d])


@pytest.mark.parametrize(
    ("family", "names", "bound"),
    [
        ("uniform", [{"slip_mean_N": 1.2, "slip_width": w} for w in (1.0, 0.5, 0.1, 0.05)], 2e-5),
        ("gaussian", [{"slip_centre_N": c, "slip_sd_N": s} for c, s in ((1, 0.03), (1, 3), (-2, 1))], 2e-5),
        (
            "power_law",
            [{"slip_max_N": 2.0, "slip_chi": c, "slip_end_share": s} for c, s in ((-0.9, 0), (5, 0.5))],
            2e-5,
        ),
    ],
)
def test_tables_of_narrow_and_singular_distributions(family, names, bound, truth):
    law = FAMILIES[family]
    for parameter_values in (truth.columns(**case) for case in names):
        table, top = law.table(parameter_values)
        phi = np.linspace(0.0, 1.0, 3001) * top[0]
        exact = truth.limited_by_sum(lambda f: law.survival(f, parameter_values)[0], phi)  # noqa: B023
        assert np.max(np.abs(read(phi, table[0], top[0]) - exact)) < bound * law.mean(parameter_values)[0], (
            parameter_values
        )


def test_mean_of_the_paper(truth, reference):
    parameter_values = truth.table_1(reference)
    assert Gammas(3).mean(parameter_values)[0] == pytest.approx(1.199, abs=5e-4)
    total, _ = integrate.quad(lambda f: f * float(Gammas(3).density(np.array([f]), parameter_values)[0, 0]), 0.0, 30.0)
    assert Gammas(3).mean(parameter_values)[0] == pytest.approx(total, rel=1e-7)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("eta1", 0.09),
        ("eta2", 81.0),
        ("t1_N", -0.2),
        ("t3_N", 0.0),
        ("g2", np.nan),
        ("t2_N", np.nan),
        ("t2_N", np.inf),
        ("eta3", np.nan),
    ],
)
def test_numbers_outside_the_tables_give_no_force(name, value, truth, reference):
    """No crash and no finite nonsense, and the draws beside it are untouched."""
    parameter_values = truth.table_1(reference, draws=3)
    sound, _ = Gammas(3).table(parameter_values)
    parameter_values[name][1] = value
    table, top = Gammas(3).table(parameter_values)
    assert np.all(np.isnan(read(np.linspace(0.01, 5.0, 40), table[1], top[1])))
    np.testing.assert_array_equal(table[[0, 2]], sound[[0, 2]])
