"""The embedded model error: nothing at zero, further elements counted, each deviation what it says."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate

from bayes_iwan.models import Model, Reference, embedded_error, series, sine_motion
from bayes_iwan.models.embedded_error import (
    CORNER_NAME,
    NAMES,
    SLIP_NAMES,
    STIFFNESS_NAME,
    TAIL_NAMES,
    DeviatingSlipForce,
)
from bayes_iwan.models.slip_force import FAMILIES

NUMBERS = {"t1_N": 0.3, "eta1": 0.9, "g1": 0.4, "t2_N": 0.2, "eta2": 5.0, "g2": 0.6}
SLIP_TERMS = (0.15, -0.12, 0.1, 0.05, -0.07, 0.05, 0.02, -0.04, 0.02, -0.01, 0.01, -0.02, 0.03, 0.02)
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


def deviated(c, base, n, phi):
    """f (1 + Σ c_k (π_{k+1}(F) − r_k π_1(F))) + Σ c_s f_s at phi over its integral, r_k such that the mean stays, by
    sums over a fine grid; f_s the density of slip forces s times as large."""
    density, survival = base.density(phi, n)[0], base.survival(phi, n)[0]
    larger = embedded_error.LARGER
    terms = len(c) - len(larger)
    pi = series.deviation_basis(terms + 1, 1.0 - survival)
    mean = integrate.trapezoid(phi * density * pi, phi, axis=1)
    own = density * (1.0 + np.array(c[:terms]) @ (pi[1:] - (mean[1:] / mean[0])[:, None] * pi[0]))
    further = sum(x * base.density(phi / s, n)[0] / s for x, s in zip(c[terms:], larger))
    return (own + further) / (1.0 + sum(c[terms:]))


def test_deviating_density_against_its_definition():
    """The family's density with its deviations; survival, density and mean agree with it."""
    base, n = FAMILIES["gamma2"], parameter_values(SLIP_TERMS)
    deviating = DeviatingSlipForce(base)
    top = base.table(n)[1][0]
    phi = np.geomspace(1e-8, 60.0, 200_001)
    raw = deviated(SLIP_TERMS, base, n, phi)
    at = np.linspace(0.02, 4.0, 60)
    below = integrate.cumulative_trapezoid(raw, phi, initial=0.0)
    np.testing.assert_allclose(deviating.survival(at, n)[0], 1.0 - np.interp(at, phi, below), atol=3e-4)
    np.testing.assert_allclose(deviating.density(at, n)[0], np.interp(at, phi, raw), rtol=0.02, atol=3e-3)
    assert integrate.trapezoid(phi * raw, phi) == pytest.approx(deviating.mean(n)[0], rel=1e-4)
    twice, four_times = SLIP_TERMS[-2:]
    ratio = (1.0 + 2.0 * twice + 4.0 * four_times) / (1.0 + twice + four_times)
    assert deviating.mean(n)[0] == pytest.approx(ratio * base.mean(n)[0], rel=1e-12)
    assert deviating.survival(np.array([0.0, 2.0 * top]), n)[0].tolist() == pytest.approx([1.0, 0.0], abs=1e-3)
    assert deviating.survival(np.array([0.5 * top]), n)[0, 0] > 5.0 * base.survival(np.array([0.5 * top]), n)[0, 0]


def test_the_force_is_linear_in_the_deviations_and_the_slopes_are_its_derivatives():
    motion = sine_motion(frequency_hz=12.0, amplitude_mm=[0.4, 1.0])
    model = Model(REFERENCE, "gamma2", embedded=True)
    both = model.force_and_slopes(parameter_values(exponent=0.1, corner=0.05), motion)
    assert both.shape == (1, 1 + len(SLIP_NAMES), 2, 128)
    found = both[:, 0] + np.einsum("k,dkts->dts", np.array(SLIP_TERMS), both[:, 1:])
    n, more = parameter_values(SLIP_TERMS, 0.1, 0.05), 1.0 + sum(SLIP_TERMS[-2:])  # elements beside the family's own
    force = model.force(n | {name: more * n[name] for name in ("k1_N_mm", "t1_N", "t2_N")}, motion)
    np.testing.assert_allclose(found, force, rtol=1e-9, atol=1e-10)
    assert np.sqrt(np.mean((force - both[:, 0]) ** 2)) > 0.01


def test_the_mean_slip_force_is_that_of_all_elements():
    """Sampled is the mean of all; there and back; where none is left, the force is no number."""
    model = Model(REFERENCE, "gamma2", embedded=True)
    values = model.values(parameter_values(SLIP_TERMS))
    there = model.parameter_values(values)
    assert values["mean_slip_force_N"] == pytest.approx(model.slip_family.mean(there), rel=1e-12)
    assert there["t1_N"] == pytest.approx(NUMBERS["t1_N"], rel=1e-12)
    impossible = model.parameter_values(values | {TAIL_NAMES[0]: np.array([-0.6])})
    motion = sine_motion(frequency_hz=12.0, amplitude_mm=1.0)
    assert np.isnan(model.force(impossible, motion)).all()


def test_further_elements_that_never_slip_are_a_spring():
    """Where no slip force of theirs is reached, they add their stiffness to the parallel spring's."""
    model = Model(REFERENCE, "uniform", stiffness="constant", normal_force="constant", embedded=True)
    motion = sine_motion(frequency_hz=12.0, amplitude_mm=0.3)
    n = parameter_values() | {"slip_mean_N": np.array([6.0]), "slip_width": np.array([0.2])}
    more = n | {TAIL_NAMES[1]: np.array([0.05])} | {name: 1.05 * n[name] for name in ("k1_N_mm", "slip_mean_N")}
    change = model.force(more, motion) - model.force(n, motion)
    np.testing.assert_allclose(change[0, 0], 0.05 * 14.0 * motion.displacement_mm[0, 0], atol=1e-9)


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
    a, widths = 0.8, np.arange(8.0)
    u = a * (1.0 - embedded_error.CORNER_WIDTH * widths)
    at = sine_motion(frequency_hz=10.0, amplitude_mm=a, samples=8)
    np.testing.assert_allclose(
        embedded_error.corner(replace(at, displacement_mm=u[None, None]))[0, 0], 1.0 / (1.0 + widths**2), rtol=1e-12
    )
