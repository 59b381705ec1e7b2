"""What the loops reach is what amplitudes and trusted harmonics allow; what lies beyond is said to be extrapolated."""

import re

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.inference.results import reach as module
from bayes_iwan.inference.results.reach import LEAST_PART, extrapolated, reach_of
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.models.bouc_wen import BoucWen

SIMPLE = {"model": {"slip": "gamma1", "normal_force": "constant", "stiffness": "constant", "embedded": False}}
ETA, MEAN_N = 2.0, 1.2


def at(problem, k1_N_mm, mean_N=MEAN_N):
    """One z with gamma slip forces of shape ETA."""
    values = {"k1_N_mm": k1_N_mm, "mean_slip_force_N": mean_N, "eta1": ETA}
    return np.array([float(problem.prior[n].score(np.array(values.get(n, v)))) for n, v in medians(problem).items()])


def medians(problem):
    return {n: float(v[0]) for n, v in problem.prior.values(np.zeros((1, problem.ndim))).items() if n in problem.names}


@pytest.fixture(scope="module")
def simple(known):
    return make_problem(known.loops(), SIMPLE)


def test_reach_is_what_amplitudes_and_band_allow(simple):
    reach = reach_of(simple, at(simple, 14.0))
    order = [np.max(np.nonzero(np.isfinite(x.noise_N))) for x in simple.loops]
    step = min(x.amplitude_mm * (1 - np.cos(np.pi / h)) for x, h in zip(simple.loops, order))
    assert reach.lowest_N == pytest.approx(0.5 * 14.0 * step) and reach.highest_N == pytest.approx(14.0, rel=1e-3)
    gamma = stats.gamma(ETA, scale=MEAN_N / ETA)
    assert reach.part == pytest.approx(reach.lowest_N / gamma.ppf(0.25), rel=1e-2)
    assert reach.quantiles_N[2] == pytest.approx(gamma.median(), rel=1e-2)
    assert reach.needed_mm == pytest.approx(gamma.ppf(1.0 - 1e-3) / 14.0, rel=1e-2)


def test_smaller_amplitudes_reach_smaller_slip_forces(known):
    some = make_problem([x for x in known.loops() if x.amplitude_mm < 0.8], SIMPLE)
    reach = reach_of(some, at(some, 3.0))
    largest = max(x.amplitude_mm for x in some.loops)
    assert largest < 0.7 and reach.amplitudes_mm[1] == largest
    assert reach.highest_N == pytest.approx(3.0 * largest, rel=1e-3)
    assert reach.never_slip == pytest.approx(stats.gamma(ETA, scale=MEAN_N / ETA).sf(3.0 * largest), rel=0.02)


@pytest.mark.parametrize("k1_N_mm", [1.5, 14.0])
def test_what_never_slips_leaves_kp_and_the_slip_forces_to_the_family(simple, k1_N_mm):
    share = stats.gamma(ETA, scale=MEAN_N / ETA).sf(k1_N_mm * 1.0)
    z = at(simple, k1_N_mm)
    assert reach_of(simple, z).never_slip == pytest.approx(share, rel=0.02, abs=1e-6)
    found = extrapolated(simple, z)
    assert ({"kp_N_mm", "k1_N_mm", "mean_slip_force_N"} <= set(found)) == (share > 1e-3)
    if share > 1e-3:
        assert f"{100 * share:.2g} % of the elements never slip at the largest amplitude, 1 mm" in found["kp_N_mm"]
        assert "are needed" in found["kp_N_mm"]
        above = stats.gamma(ETA, scale=MEAN_N / ETA).ppf(0.95) > k1_N_mm
        assert ("slip_force_q95_N" in found) == above
    else:
        assert found == {}


def test_draws_are_asked_for_the_expected_share(simple):
    z = np.stack([at(simple, 14.0), at(simple, 1.5)])
    one = reach_of(simple, z[1]).never_slip
    assert reach_of(simple, z).never_slip == pytest.approx(0.5 * one, rel=1e-3)
    assert "kp_N_mm" in extrapolated(simple, z)


@pytest.mark.parametrize("k1_N_mm", [[4.0, 4.0], [5.3, 5.3], [9.0, 4.5], [14.0, 14.0, 14.0, 1.5]])
def test_larger_tests_are_asked_for_where_elements_never_slip(simple, k1_N_mm):
    """At the amplitude that leaves the mean share, larger as it is printed too, where half the draws need none."""
    reach = reach_of(simple, z := np.stack([at(simple, k1) for k1 in k1_N_mm]))
    gamma, largest = stats.gamma(ETA, scale=MEAN_N / ETA), reach.amplitudes_mm[1]
    assert reach.never_slip > 1e-3 and reach.needed_mm > largest
    assert np.mean(gamma.sf(np.array(k1_N_mm) * reach.needed_mm)) == pytest.approx(1e-3, rel=0.05)
    shown, needed = map(float, re.findall(r"(\S+) mm", extrapolated(simple, z)["kp_N_mm"]))
    assert needed > shown == pytest.approx(largest, rel=1e-2)


@pytest.mark.parametrize("coarse", [1.0, 60.0])
def test_what_lies_below_the_finest_step_is_said_to_be_extrapolated(simple, coarse, monkeypatch):
    """Steps of so many times their size."""
    monkeypatch.setattr(module, "_step_mm", lambda loop, finest=module._step_mm: coarse * finest(loop))
    z = at(simple, 14.0)
    reach = reach_of(simple, z)
    gamma = stats.gamma(ETA, scale=MEAN_N / ETA)
    below = [f"slip_force_q{q:02d}_N" for q in (5, 25, 50, 75, 95) if gamma.ppf(q / 100) < reach.lowest_N]
    if reach.lowest_N / gamma.ppf(0.25) > LEAST_PART:
        below.append("k1_N_mm")
    assert {n for n, why in extrapolated(simple, z).items() if "no step under" in why} == set(below)
    assert bool(below) == (coarse > 1.0)


def test_a_simulator_without_slip_forces_has_no_reach(known):
    problem = make_problem(known.loops(), {}, simulator=BoucWen())
    z = np.zeros(problem.ndim)
    assert reach_of(problem, z) is None and extrapolated(problem, z) == {}
