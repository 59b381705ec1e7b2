"""How fine is fine enough: elements, samples a cycle. Errors are RMS over RMS of the friction force."""

import numpy as np
import pytest

from bayes_iwan.models import Model, sine_motion
from bayes_iwan.models.motion import Motion
from bayes_iwan.models.normal_force import ALPHA_FLOOR
from jenkins_elements import element_force, equal_probability_sliders

AMPLITUDES, FREQUENCIES = np.repeat([0.03, 0.1, 0.3, 0.6, 1.0], 2), np.tile([10.0, 20.0], 5)


def rms(x):
    return np.sqrt(np.mean(np.square(x), axis=-1))


def shifted(samples, phase):
    """Sines sampled so that their extremes fall between samples; phase in cycles. And one with a third harmonic."""
    base = sine_motion(frequency_hz=FREQUENCIES, amplitude_mm=AMPLITUDES, samples=samples)
    p = 2.0 * np.pi * (np.arange(samples) / samples + phase)
    a, omega = base.amplitude_mm[:, None], 2.0 * np.pi * base.frequency_hz[:, None]
    u = a * (np.sin(p) + 0.05 * np.sin(3.0 * p + 1.0))
    v = 1e-3 * omega * a * (np.cos(p) + 0.15 * np.cos(3.0 * p + 1.0))
    return Motion(
        displacement_mm=u[None],
        velocity_m_s=v[None],
        acceleration_m_s2=-1e-3 * omega**2 * u[None],
        frequency_hz=base.frequency_hz,
        amplitude_mm=np.max(u, axis=1),
        cycle=base.cycle,
        test=base.test,
    )


def draws(truth, reference, how):
    """Table 1 scattered, or with α reaching from half to twice its value and beyond within a cycle."""
    parameter_values = truth.table_1(reference, draws=24, spread=0.3)
    if how == "strongly varying":
        rng = np.random.default_rng(1)
        parameter_values |= {
            "normal_force_slope": rng.uniform(-0.35, 0.35, 24),
            "normal_force_rate": rng.uniform(0.0, 0.5, 24),
            "beta": rng.uniform(0.05, 1.5, 24),
        }
    return parameter_values


def sampling_error(model, parameter_values, samples):
    """RMS errors (draws, loops, phases) against 4096 samples a cycle."""
    errors = []
    for phase in (0.0, 0.31 / samples, 0.77 / samples):
        fine = model.friction_force(parameter_values, shifted(4096, phase))
        coarse = model.friction_force(parameter_values, shifted(samples, phase))
        errors.append(rms(coarse - fine[..., :: 4096 // samples]) / rms(fine))
    return np.stack(errors, axis=-1)


@pytest.mark.parametrize(("how", "bound"), [("Table 1", 2e-4), ("strongly varying", 4e-4)])
def test_128_samples_a_cycle_are_plenty(how, bound, truth, reference):
    """Below the 0.1 % asked for, at every amplitude (measured, worst of all: Table 1 0.011 %, varying α 0.021 %)."""
    model, parameter_values = Model(reference), draws(truth, reference, how)
    alpha = model.alpha(parameter_values, shifted(128, 0.0))
    if how == "strongly varying":
        assert alpha.min() < 0.5 and alpha.max() > 1.7
    assert np.max(sampling_error(model, parameter_values, 128)) < bound
    assert np.quantile(sampling_error(model, parameter_values, 64), 0.95) < 1e-3  # half the default nearly would do


def test_order_in_samples(truth, reference):
    """Between samples only the curvature of turning points and the meeting of fronts are missed: order 2 to 3."""
    model, parameter_values = Model(reference), draws(truth, reference, "Table 1")
    error = [np.median(sampling_error(model, parameter_values, n)) for n in (16, 64, 256)]
    order = np.log(np.array(error[:-1]) / error[1:]) / np.log(4.0)
    assert np.all(order > 1.8), (error, order)


def test_missed_turning_points_would_be_first_order_news(truth, reference):
    """Without the vertices of its parabolas, a loop whose extremes fall between 128 samples is 1e-3 off: here the
    literal samples are followed by elements, and the sliders beat them by a factor of twenty."""
    model, parameter_values = Model(reference), truth.table_1(reference)
    motion, fine = shifted(128, 0.5 / 128), shifted(4096, 0.5 / 128)
    alpha = model.alpha(parameter_values, motion)
    k = model.stiffness_law.k(parameter_values, alpha)
    phi = equal_probability_sliders(lambda f: model.slip_family.survival(f, parameter_values)[0], 3000, 12.0)
    exact = model.friction_force(parameter_values, fine)[0, :, ::32]
    literal = np.array(
        [
            element_force(u, a, kk, phi, np.full(3000, 1 / 3000), passes=2)
            for u, a, kk in zip(motion.displacement_mm[0], alpha[0], k[0])
        ]
    )
    ours = model.friction_force(parameter_values, motion)[0]
    assert np.max(rms(literal - exact) / rms(exact)) > 5e-4
    assert np.max(rms(ours - exact)) < 0.05 * np.max(rms(literal - exact))


@pytest.mark.parametrize("amplitude", [0.1, 0.3, 1.0])
def test_elements_converge_to_the_sliders(amplitude, truth, reference):
    """Equal-probability elements come nearer as 1/n where all slip (the thin tail decides) to 1/n² where few do.

    Measured for Table 1 at A = 1 mm: 0.14 % with 128 elements, 0.009 % with 2,048, 0.001 % with 20,000.
    """
    model, parameter_values, motion = (
        Model(reference),
        truth.table_1(reference),
        sine_motion(frequency_hz=15.0, amplitude_mm=amplitude),
    )
    alpha = model.alpha(parameter_values, motion)
    k = model.stiffness_law.k(parameter_values, alpha)
    ours = model.friction_force(parameter_values, motion)[0, 0]
    error = []
    for count in (32, 128, 512, 2048, 8192):
        phi = equal_probability_sliders(lambda f: model.slip_family.survival(f, parameter_values)[0], count, 12.0)
        force = element_force(motion.displacement_mm[0, 0], alpha[0, 0], k[0, 0], phi, np.full(count, 1 / count), 2)
        error.append(rms(force - ours) / rms(ours))
    order = np.log(error[0] / error[2]) / np.log(512 / 32)
    assert np.all(np.diff(error) < 0) and 0.9 < order < 2.2, (error, order)
    assert error[1] < 2e-3 and error[-1] < 3e-5, error


def test_floor_of_alpha_is_met_sharply(truth, reference):
    """Where α meets its floor it has a kink, met between two samples: still within 0.2 % of the friction force."""
    model, parameter_values = Model(reference), truth.table_1(reference)
    parameter_values |= {"normal_force_slope": np.array([-1.5]), "beta": np.array([1.0])}
    assert np.any(model.alpha(parameter_values, shifted(128, 0.0)) == ALPHA_FLOOR)
    assert np.max(sampling_error(model, parameter_values, 128)) < 2e-3
