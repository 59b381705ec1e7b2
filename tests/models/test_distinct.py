"""Draws that agree in what a law reads: computed once, to the same bits."""

import numpy as np
import pytest

from bayes_iwan.effects import catalogue
from bayes_iwan.models import Scales, Simulator, sine_motion
from bayes_iwan.models.kernels import pointwise
from bayes_iwan.models.parameter import for_distinct
from bayes_iwan.models.simulator import recorded_force


def test_a_law_is_asked_once_of_draws_that_agree():
    asked = []

    def law(values):
        asked.append(values["a"].copy())
        return np.stack([values["a"] + values["b"], values["a"]], axis=1)

    values = {"a": np.array([1.0, 2.0, 1.0, 2.0, 1.0]), "b": np.array([0.0, 0.0, 0.0, 0.0, 3.0]), "c": np.arange(5.0)}
    found = for_distinct(law, ("a", "b"), values)
    np.testing.assert_array_equal(asked[0], [1.0, 2.0, 1.0])
    np.testing.assert_array_equal(found, [[1.0, 1.0], [2.0, 2.0], [1.0, 1.0], [2.0, 2.0], [4.0, 1.0]])
    for_distinct(law, ("a", "b", "c"), values)
    assert len(asked[1]) == 5


def test_a_simulator_is_asked_once_of_draws_that_differ_in_an_outer_effect_alone():
    asked = []

    class Spring(Simulator):
        name = "spring"

        def parameters(self, scales):
            return ()

        def force(self, parameter_values, motion, effects=()):
            asked.append(len(parameter_values["k_N_mm"]))
            return parameter_values["k_N_mm"][:, None, None] * motion.displacement_mm

    scales = Scales(length_mm=0.9, speed_m_s=0.113, force_N=4.0, slip_N=1.2, soft_N_mm=5.5, stiff_N_mm=15.0)
    damping = next(e for e in catalogue.BUILT_IN if e.name == "viscous_damping")(scales, ())
    values = {"k_N_mm": np.array([2.0, 2.0, 3.0])}
    for i, p in enumerate(damping.parameters):
        values[p.name] = p.value(np.array([0.0, 0.5, 1.0]) + 0.1 * i)
    motion = sine_motion(frequency_hz=10.0, amplitude_mm=0.5)
    force = recorded_force(Spring(), (damping,), values, motion)
    assert asked == [2]
    zero = np.zeros_like(force)
    spring = values["k_N_mm"][:, None, None] * motion.displacement_mm
    np.testing.assert_array_equal(force, spring + damping.force(zero, motion, values))


@pytest.mark.parametrize("draws", [1, 7])
def test_compiled_powers_are_numpys(draws):
    rng = np.random.default_rng(2)
    x, p = rng.lognormal(0.0, 3.0, (draws, 500)), rng.uniform(0.3, 4.0, 7)
    x[:, 0] = 0.0
    out = np.empty((7, 500))
    pointwise.power(-x, p, out)
    np.testing.assert_allclose(out[:, 1:], (x ** p[:, None])[:, 1:], rtol=1e-12)
    assert out[:, 0].max() < 1e-80
    pointwise.falling(x, p, out)
    np.testing.assert_allclose(out, (1.0 + p[:, None] * x) ** (-1.0 / p[:, None]), rtol=1e-12)
    pointwise.falling(x, -p, out)
    inside = 1.0 - p[:, None] * x
    np.testing.assert_allclose(out, np.maximum(inside, 0.0) ** (1.0 / p[:, None]), rtol=1e-10, atol=1e-60)
    pointwise.growing(x, p, out)
    np.testing.assert_allclose(out, ((1.0 + x) ** p[:, None] - 1.0) / p[:, None], rtol=1e-11, atol=1e-14)
    for law in (pointwise.power, pointwise.falling, pointwise.growing):  # what is no number must not become one
        law(np.full((1, 500), np.nan), p, out)
        assert np.isnan(out).all()


def test_speeds_of_a_change_are_its_central_differences():
    phase, hz, samples = 2.0 * np.pi * np.arange(256) / 256, np.array([8.0, 20.0]), 256
    old, speed = np.zeros((1, 2, samples)), np.full((1, 2, samples), 3.0)
    new = np.array([0.5, 2.0, 0.0])[:, None, None] * np.sin(phase) * np.ones((2, 1))
    velocity, acceleration = np.empty_like(new), np.empty_like(new)
    pointwise.speeds_of_change(new, old, speed, old, 0.5 * hz * samples, velocity, acceleration)
    omega = 2.0 * np.pi * hz[:, None]
    size = np.array([0.5e-3, 2e-3, 0.0])[:, None, None]
    np.testing.assert_allclose(velocity - 3.0, size * omega * np.cos(phase), atol=1e-3 * 2e-3 * omega.max())
    np.testing.assert_allclose(acceleration, -size * omega**2 * np.sin(phase), atol=1e-3 * 2e-3 * omega.max() ** 2)
    assert np.all(velocity[2] == 3.0) and np.all(acceleration[2] == 0.0)
