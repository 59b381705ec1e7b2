"""A user's simulator that has no force, a complex one, or one that depends on other draws is named with its values."""

import warnings

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.inference.identify import identify_problem
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.setup.simulator_check import NoForce, check_simulator
from bayes_iwan.models import ModelError, Parameter, Simulator


class Mine(Simulator):
    """Spring and friction; `spoilt` says what becomes of the force."""

    name = "mine"

    def __init__(self, spoilt):
        self.spoilt = spoilt

    def parameters(self, scales):
        return (
            Parameter("k_N_mm", "k", "N/mm", "spring", stats.lognorm(s=1.0, scale=scales.soft_N_mm)),
            Parameter("f_N", "F", "N", "friction", stats.lognorm(s=0.8, scale=scales.slip_N)),
        )

    def force(self, parameter_values, motion, effects=()):
        u, v = motion.displacement_mm, motion.velocity_m_s
        k, f = (parameter_values[n][:, None, None] for n in ("k_N_mm", "f_N"))
        return self.spoilt(k * u + f * np.tanh(20.0 * v / np.abs(v).max()), parameter_values["f_N"])


def nan_above(limit):
    def spoilt(force, f):
        force[f > limit(f)] = np.nan
        return force

    return spoilt


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        (nan_above(lambda f: 1.1 * np.median(f)), r"at k_N_mm = .*, f_N = .* is not a number among other draws"),
        (nan_above(lambda f: -1.0), r"no draw of its prior has a finite force, for example k_N_mm = .*, f_N = "),
        (lambda force, f: force + 1j * f[:, None, None], r"complex numbers, for example at k_N_mm = .*, f_N = "),
        (lambda force, f: force[0], r"`force` returns shape \(4, 128\), not \(draws, tests, samples\) \(200, 4, 128\)"),
        (lambda force, f: force - force.mean(axis=0), r"N RMS alone; `force` must treat every draw"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(known, spoilt, said):
    problem = make_problem(known.loops(), {}, Mine(spoilt))
    with pytest.raises(ModelError, match=said) as caught:
        check_simulator(problem)
    assert "\n" not in str(caught.value)


def test_no_force_in_a_part_of_the_prior_is_warned_of_and_lived_with(known):
    sound = make_problem(known.loops(), {}, Mine(lambda force, f: force))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_simulator(sound)
    limit = 0.9 * sound.scales.slip_N  # the loops would have more, so draws lie on the edge
    partly = make_problem(known.loops(), {}, Mine(nan_above(lambda f: limit)))
    with pytest.warns(NoForce, match=r"no finite force in .* % of its prior, for example at k_N_mm = .*, f_N = "):
        check_simulator(partly)
    posterior = identify_problem(partly, 1, quick=True, progress=False)
    assert np.isfinite(posterior.log_prob).all() and np.isfinite(posterior.predict(10.0, 0.5).force_N).all()


def test_a_motion_that_is_changed_is_refused(known):
    """Speeds were 1 m/s from then on, in effects and on the model card too."""

    class InPlace(Mine):
        def force(self, parameter_values, motion, effects=()):
            speed = motion.velocity_m_s
            speed /= np.abs(speed).max()
            return super().force(parameter_values, motion)

    with pytest.raises(ModelError, match="changes the motion's arrays, which all calls share; change a copy"):
        check_simulator(make_problem(known.loops(), {}, InPlace(lambda force, f: force)))
