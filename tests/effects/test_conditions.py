"""What was stated for each test: it reaches the motion, and slip forces, stiffness and zero follow it."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign import Record, average
from bayes_iwan.effects import catalogue
from bayes_iwan.effects.conditions import conditions_of
from bayes_iwan.models import Model, sine_motion
from bayes_iwan.models.motion import motion_of
from bayes_iwan.models.simulator import recorded_force

PRESSURES = (1.0, 2.0, 4.0)


def under_pressure(**more):
    return replace(
        sine_motion(frequency_hz=20.0, amplitude_mm=[0.9] * 3, samples=256),
        conditions={"pressure_bar": np.array(PRESSURES)} | more,
    )


def made(kit, name, conditions=None):
    (maker,) = catalogue.variants(conditions=conditions or {"pressure_bar": PRESSURES})[name]
    return maker(kit.scales, ("a.csv", "b.csv", "c.csv"))


def parameter_values_of(effect, **given):
    out = {p.name: p.value(np.zeros(1)) for p in effect.parameters}
    return out | {f"{effect.name}.{n}": np.array([v]) for n, v in given.items()}


def test_conditions_are_the_numbers_that_all_tests_state_and_that_differ():
    extras = [{"pressure_bar": p, "rig": 3.0, "humidity": 0.4} for p in PRESSURES]
    del extras[1]["humidity"]
    assert conditions_of(extras) == {"pressure_bar": PRESSURES}
    assert conditions_of([]) == {} and conditions_of([{"pressure_bar": 1.0}]) == {}
    offered = catalogue.variants(conditions=conditions_of(extras))
    assert {n for n in offered if "pressure" in n} == {
        f"{what}_follows_pressure_bar" for what in ("slip_forces", "stiffness", "force_zero")
    }
    assert not any("follows" in n for n in catalogue.variants())


def test_loops_carry_what_was_stated_into_the_motion_block_by_block():
    time = np.arange(12 * 100) / 1000.0
    loops = [
        average(
            Record(f"{p}.csv", 10.0, 1.0, "fit", {"pressure_bar": p}, time, np.sin(20 * np.pi * time), time * 0.0 + p),
            n_phase=32,
            n_harmonics=5,
            n_blocks=3,
        )
        for p in PRESSURES
    ]
    assert motion_of(loops).conditions["pressure_bar"].tolist() == list(PRESSURES)
    blocks = motion_of(loops, blocks=True)
    assert blocks.conditions["pressure_bar"].tolist() == [p for x, p in zip(loops, PRESSURES) for _ in x.block_cycle]
    assert blocks.span_cycles.tolist() == [x.n_cycles / len(x.block_cycle) for x in loops for _ in x.block_cycle]


def mid_stroke(kit, effect, at, **given):
    """Friction where all elements slip, over what it is without the effect."""
    model = Model(kit.reference, normal_force="constant", stiffness="constant")
    base = kit.parameter_values(model, kp_N_mm=0.0, k1_N_mm=1000.0)
    with_it = recorded_force(model, (effect,), base | parameter_values_of(effect, **given), at)
    return (with_it / recorded_force(model, (), base, at))[0, :, 0]


def test_slip_forces_follow_a_power_of_the_pressure_or_an_exponential(kit):
    effect, p = made(kit, "slip_forces_follows_pressure_bar"), np.array(PRESSURES)
    power = mid_stroke(kit, effect, under_pressure(), exponent=0.7, form=0.0)
    np.testing.assert_allclose(power / power[0], (p / p[0]) ** 0.7, rtol=1e-6)
    assert np.prod(power) == pytest.approx(1.0, rel=1e-6)  # about the geometric mean
    for q in (0.05, 1.0):
        growing = mid_stroke(kit, effect, under_pressure(), exponent=0.7, form=q)
        expected = np.exp(0.7 * ((p / 2.0) ** q - (p[0] / 2.0) ** q) / q)
        np.testing.assert_allclose(growing / growing[0], expected, rtol=1e-6)


def test_stiffness_follows_alone_or_with_the_slip_forces(kit):
    at, alpha = under_pressure(), np.ones((1, 3, 256))
    alone, both = made(kit, "stiffness_follows_pressure_bar"), made(kit, "slip_forces_follows_pressure_bar")
    expected = 5.0 * (np.array(PRESSURES) / 2.0) ** 0.3
    k = alone.stiffness(5.0 * alpha, alpha, at, parameter_values_of(alone, exponent=0.3))[0, :, 0]
    np.testing.assert_allclose(k, expected, rtol=1e-6)
    np.testing.assert_array_equal(alone.slip(alpha, at, parameter_values_of(alone, exponent=0.3)), alpha)
    k = both.stiffness(5.0 * alpha, alpha, at, parameter_values_of(both, exponent=0.6, of_stiffness=0.5))[0, :, 0]
    np.testing.assert_allclose(k, expected, rtol=1e-6)


def test_zero_follows_a_temperature_that_is_not_positive(kit):
    degrees = (-10.0, 0.0, 40.0)
    effect = made(kit, "force_zero_follows_temperature_C", {"temperature_C": degrees})
    assert [p.name for p in effect.parameters] == ["force_zero_follows_temperature_C.force_N"]
    at = replace(
        sine_motion(frequency_hz=20.0, amplitude_mm=[0.9] * 3), conditions={"temperature_C": np.array(degrees)}
    )
    shift = effect.force(np.zeros((1, 3, 128)), at, parameter_values_of(effect, force_N=2.0))[0, :, 0]
    np.testing.assert_allclose(shift, 2.0 * (np.array(degrees) - 10.0) / 30.0)


def test_a_test_that_states_nothing_is_at_the_reference(kit):
    effect = made(kit, "slip_forces_follows_pressure_bar")
    np.testing.assert_allclose(
        mid_stroke(kit, effect, sine_motion(frequency_hz=20.0, amplitude_mm=[0.9] * 3, samples=256), exponent=0.7), 1.0
    )


def test_a_new_test_is_measured_from_the_fitted_ones(kit):
    """The reference stays that of the fitted tests when other tests are predicted."""
    effect = made(kit, "slip_forces_follows_pressure_bar")
    one = replace(
        sine_motion(frequency_hz=20.0, amplitude_mm=[0.9], samples=256), conditions={"pressure_bar": np.array([8.0])}
    )
    assert mid_stroke(kit, effect, one, exponent=0.5, form=0.0)[0] == pytest.approx(2.0, rel=1e-6)
