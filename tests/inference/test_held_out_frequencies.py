"""Frequencies held out and predicted: bands hold where the model is right, and it is said where they do not."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign import read_campaign
from bayes_iwan.inference.results.held_out_frequencies import (
    HeldOutFrequency,
    held_out_frequencies,
    held_out_said,
    predicted,
)
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.solving.point import laplace_scale, most_probable
from bayes_iwan.models.motion import motion_of

pytestmark = pytest.mark.usefixtures("few_quick_walkers")

SETTINGS = {"model": {"slip": "gamma1", "normal_force": "constant", "stiffness": "constant", "embedded": False}}


@pytest.fixture(scope="module")
def loops(made_up_campaign):
    """Four tests of one specimen, two at each of two frequencies: the model is one without rate effects."""
    two = read_campaign(made_up_campaign).loops(n_phase=64, n_harmonics=24)
    higher = [replace(x, file=f"again_{x.file}", frequency_hz=20.0) for x in two]
    rng = np.random.default_rng(3)
    noise = [0.002 * rng.standard_normal(x.force_N.size) for x in higher]
    return [*two, *(replace(x, force_N=x.force_N + e) for x, e in zip(higher, noise))]


def optima_of(problem):
    first = problem.prior.draw(np.random.default_rng(1), 200)
    return most_probable(problem, first[np.argsort(problem.goal(first))[:6]])[0]


def draws_of(problem):
    """Those of the normal approximation at the optimum."""
    z = optima_of(problem)[0]
    return z + np.random.default_rng(2).standard_normal((500, problem.ndim)) @ laplace_scale(problem, z).T


def test_a_right_model_holds_a_frequency_held_out(loops):
    problem = make_problem(loops, SETTINGS)
    found = held_out_frequencies(problem, draws_of(problem))
    assert [x.frequency_hz for x in found] == pytest.approx([10.0, 20.0])
    assert all(x.points_90 > 0.8 and x.points_50 < x.points_90 for x in found)
    assert "do not trust" not in held_out_said(found)


def test_a_frequency_of_another_force_is_not_held_and_is_named(loops):
    """At 20 Hz a third more force: what 10 Hz says of it is wrong, and the other way round."""
    wrong = [replace(x, force_N=1.3 * x.force_N) if x.frequency_hz > 15.0 else x for x in loops]
    problem = make_problem(wrong, SETTINGS)
    found = held_out_frequencies(problem, draws_of(problem))
    assert max(x.points_90 for x in found) < 0.5
    assert "at 20 Hz only" in held_out_said(found) and "do not trust predictions there" in held_out_said(found)


def test_mean_forces_which_drift_are_left_aside(loops):
    """A zero of 2 N, and another of the frequency held out, are seen neither in the prediction nor in what it meets."""
    off = [replace(x, force_N=x.force_N + (2.0 if x.frequency_hz < 15.0 else 5.0)) for x in loops]
    problem = make_problem(off[:2], SETTINGS)
    force, measured = predicted(problem, np.tile(optima_of(problem)[0], (400, 1)), off[2:], 1)
    assert force.shape == (400, 2, 64) and np.abs(force.mean(axis=-1)).max() < 1e-9
    assert measured == pytest.approx(np.stack([x.force_N - x.force_N.mean() for x in loops[2:]]))
    middle = np.median(force, axis=0)
    assert np.sqrt(np.mean((middle - measured) ** 2)) < 0.1 * np.sqrt(np.mean(measured**2))


def test_what_the_others_miss_is_carried_over_to_the_frequency_held_out(loops):
    """A force of 0.2 N along the velocity that no parameters explain: the prediction follows it, on the same side."""
    problem = make_problem(loops[:2], SETTINGS)
    values = problem.prior.values(np.zeros((1, problem.ndim)))
    values |= {"discrepancy_odd": np.array([0.3]), "discrepancy_even": np.array([0.01])}  # as large, and known to be
    z = problem.prior.scores(values)
    missed = 0.2 * np.cos(2.0 * np.pi * loops[0].phase)
    off = problem.with_force(problem.predict(z)[0] + missed)
    force, _ = predicted(off, np.tile(z, (400, 1)), loops[2:], 1)
    first = np.fft.rfft(np.median(force, axis=0) - problem.predict(z, motion_of(loops[2:]))[0])[:, 1] / 32.0
    assert np.all(first.real > 0.05)


def test_one_frequency_alone_says_nothing(loops):
    problem = make_problem(loops[:2], SETTINGS)
    assert held_out_frequencies(problem, np.zeros((1, problem.ndim))) == ()
    assert held_out_said(()) == ""
    said = held_out_said(
        (HeldOutFrequency(10.0, ("a",), 0.5, 0.92, 1.0), HeldOutFrequency(30.0, ("b",), 0.2, 0.36, 0.5))
    )
    assert "hold 64 % of its points in the mean, at 30 Hz only 36 %: do not trust" in said


@pytest.mark.parametrize("points_90, held", [(0.74, False), (0.76, True)])
def test_bands_of_90_per_cent_that_hold_three_quarters_of_the_points_hold(points_90, held):
    one = HeldOutFrequency(10.0, ("a",), 0.5, points_90, 1.0)
    assert one.holds == held == ("do not trust" not in held_out_said((one,)))
