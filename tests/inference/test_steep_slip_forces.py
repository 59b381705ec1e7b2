"""Slip forces that end at once: the default priors must let a component be as steep, or kp pays for it."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign.loops.averaging import average
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.solving.point import most_probable
from bayes_iwan.virtual_rig import simulate as rig
from bayes_iwan.virtual_rig.specimen import paper_specimen

SLIP_N = 1.2


@pytest.fixture(scope="module")
def uniform():
    """Loops of a specimen with slip forces uniform from a fifth of the largest on, and its parallel stiffness."""
    n, setup = 300, rig.Setup()
    phi = 0.2 + 0.8 * (np.arange(n) + 0.5) / n
    specimen = replace(
        paper_specimen(n),
        slip_share_N=SLIP_N * phi / phi.sum(),
        beta=0.4,
        kn_1_mm=0.2,
        lambda_s_m=1.0,
        family="uniform",
    )
    tests = tuple(rig.PlannedTest(f, a, cycles=12) for f in (8.0, 20.0) for a in (0.25, 0.5, 0.8))
    runs = rig.VirtualRig(specimen, setup, seed=3).run_all(tests)
    kp = 1.0 / (1.0 / specimen.parallel_N_mm + setup.fixture_compliance_mm_N)
    return [average(r, 64, 24) for r in rig.records(runs)], kp


def errors(loops, kp, config):
    """Relative errors of the parallel stiffness and the mean slip force at the most probable point."""
    problem = make_problem(loops, config)
    z = problem.prior.draw(np.random.default_rng(0), 320)
    optima, _, _ = most_probable(problem, z[np.argsort(problem.goal(z))[:8]])
    found = problem.parameter_values(optima[:1])
    return float(found["kp_N_mm"][0]) / kp - 1.0, float(found["mean_slip_force_N"][0]) / SLIP_N - 1.0


def test_the_parallel_spring_does_not_pay_for_slip_forces_that_end_at_once(uniform):
    loops, kp = uniform
    plain = {"model": {"embedded": False}}  # an embedded model error pays for it, too
    stiffness, slip = errors(loops, kp, plain)
    assert abs(stiffness) < 1e-3 and abs(slip) < 2e-3
    blunt, _ = errors(loops, kp, plain | {"parameters": {f"eta{i}": {"upper": 16.0} for i in (1, 2, 3)}})
    assert blunt < -2.0 * abs(stiffness)  # elements that never slip would stand in for a part of kp
