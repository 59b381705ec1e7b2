"""The embedded model error: nothing at zero, the mean slip force kept, each deviation what it says."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate

from bayes_iwan.models import Model, Reference, embedded_error, series, sine_motion
from bayes_iwan.models.embedded_error import CORNER_NAME, NAMES, SLIP_NAMES, STIFFNESS_NAME, DeviatingSlipForce
from bayes_iwan.models.iwan_parameters import SLIP_SD
from bayes_iwan.models.slip_force import FAMILIES

NUMBERS = {"t1_N": 0.3, "eta1": 0.9, "g1": 0.4, "t2_N": 0.2, "eta2": 5.0, "g2": 0.6}
SLIP_TERMS = (0.3, -0.25, 0.2, 0.1, -0.15, 0.1, 0.05, -0.08)
NONE = (0.0,) * len(SLIP_NAMES)
REFERENCE = Reference(1.0, 0.12566)


def parameter_values(deviations=NONE, exponent=0.0, corner=0.0):
    out = NUMBERS | dict(zip(SLIP_NAMES, deviations)) | {STIFFNESS_NAME: exponent, CORNER_NAME: corner}
    out |= {"kp_N_mm": 5.0, "k1_N_mm": 14.0, "stiffness_ratio": 0.6}
    out |= {"normal_force_slope": 0.3, "normal_force_rate": 0.1, "beta": 0.6}
    return {k: np.array([v]) for k, v in out.items()}


def test_no_bend_is_the_plain_model():
    motion = sine_motion(frequency_hz=12.0, amplitude_mm=[0.4, 1.0])
    plain, bendable = Model(REFERENCE, "gamma2"), Model(REFERENCE, "gamma2", embedded=True)
    n = parameter_values()
    np.testing.assert_array_equal(bendable.force(n, motion), plain.force(n, motion))
    assert set(bendable.names) == {*plain.names, *NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_every_bend_changes_the_force(name):
    motion = sine_motion(frequency_hz=12.0, amplitude_mm=[0.4, 1.0])
    model = Model(REFERENCE, "gamma2", embedded=True)
    change = model.force(parameter_values() | {name: np.array([0.1])}, motion) - model.force(parameter_values(), motion)
    assert 1e-4 < np.sqrt(np.mean(change**2)) < 0.2


def test_deviating_density_against_its_definition(density_ratio):
    """exp(Σ c π(F)) times the family's density, stretched so that the mean stays; survival and density agree."""
    base, n = FAMILIES["gamma2"], parameter_values(SLIP_TERMS)
    deviating = DeviatingSlipForce(base)
    phi = np.linspace(0.0, 6.0, 200_001)
    p = 1.0 - base.survival(phi, n)[0]
    raw = base.density(phi[1:], n)[0] * density_ratio(np.array([SLIP_TERMS]), p[1:])[0]
    mean = integrate.trapezoid(phi[1:] * raw, phi[1:])
    stretch = base.mean(n)[0] / mean
    below = 1.0 - integrate.cumulative_trapezoid(raw[::-1], -phi[:0:-1], initial=0.0)[::-1]
    at = np.linspace(0.02, 4.0, 60)
    np.testing.assert_allclose(deviating.survival(at, n)[0], np.interp(at / stretch, phi[1:], 1.0 - below), atol=2e-4)
    np.testing.assert_allclose(
        deviating.density(at, n)[0], np.interp(at / stretch, phi[1:], raw) / stretch, rtol=0.01, atol=1e-3
    )
    fine = np.geomspace(1e-7, 8.0, 40_001)
    assert integrate.trapezoid(deviating.survival(fine, n)[0], fine) == pytest.approx(deviating.mean(n)[0], rel=1e-3)
    assert deviating.survival(np.array([0.0, 50.0]), n)[0].tolist() == pytest.approx([1.0, 0.0], abs=1e-3)


def test_tables_of_deviations_hold_the_mean_force_of_limited_elements():
    """The table's E[min(φ, x)], from which friction is read, against four times as many cells of p."""
    rng, n = np.random.default_rng(4), 60
    g = rng.dirichlet((1.0, 1.0, 1.0), n)
    drawn = {f"g{i}": g[:, i - 1] for i in (1, 2, 3)}
    drawn |= {f"t{i}_N": np.exp(rng.normal(-1.0, 0.7, n)) for i in (1, 2, 3)}
    drawn |= {f"eta{i}": np.exp(rng.normal(0.7, 0.9, n)).clip(0.12, 40.0) for i in (1, 2, 3)}
    tables, top = FAMILIES["gamma3"].table(drawn)
    c = rng.standard_normal((n, len(SLIP_NAMES))) * SLIP_SD / np.arange(1, len(SLIP_NAMES) + 1)
    found = series.deviating_to_mean(tables, top, c)[0][:, :, 0]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(series, "_P_CELLS", 4 * series._P_CELLS)
        series._cells_basis.cache_clear()
        fine = series.deviating_to_mean(tables, top, c)[0][:, :, 0]
    series._cells_basis.cache_clear()
    off = np.max(np.abs(found - fine), axis=1) / np.max(fine, axis=1)
    assert np.median(off) < 2e-6
    assert np.max(off) < 2e-4


def test_the_exponent_leaves_k1_and_bends_the_rest():
    alpha = np.array([[[0.5, 1.0, 2.0]]])
    k = np.full(alpha.shape, 7.0)
    embedded_error.deviate_stiffness(k, alpha, parameter_values(exponent=0.2))
    np.testing.assert_allclose(k[0, 0], 7.0 * alpha[0, 0] ** 0.2)


def test_the_corner_is_at_the_end_of_the_stroke():
    motion = sine_motion(frequency_hz=12.0, amplitude_mm=[0.4, 1.0])
    alpha = np.ones((1, 2, 128))
    embedded_error.deviate_normal_force(alpha, motion, parameter_values(corner=0.1))
    top = np.argmax(motion.displacement_mm[0], axis=1)
    np.testing.assert_allclose(alpha[0, [0, 1], top], np.exp(0.1), rtol=1e-6)
    assert np.all(np.abs(alpha[0][motion.displacement_mm[0] < 0.5 * motion.amplitude_mm[:, None]] - 1.0) < 2e-3)


def test_the_corner_is_felt_near_the_end_of_the_stroke_and_falls_off_as_a_lorentzian():
    a, width = 0.8, embedded_error.CORNER_WIDTH
    u = a * (1.0 - width * np.array([0.0, 1.0, 2.0, 3.0]))
    at = sine_motion(frequency_hz=10.0, amplitude_mm=a, samples=4)
    np.testing.assert_allclose(
        embedded_error.corner(replace(at, displacement_mm=u[None, None]))[0, 0], [1.0, 1 / 2, 1 / 5, 1 / 10], rtol=1e-12
    )
