"""Loops made from known numbers, without a campaign folder."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_iwan.campaign import Record, average
from bayes_iwan.inference import defaults
from bayes_iwan.inference.problem import make_problem
from bayes_iwan.physics import Model, sine_motion
from bayes_iwan.physics.normal_force import Reference, from_paper_hunt_crossley
from bayes_iwan.physics.stiffness import from_paper_stiffness

TESTS = ((10.0, 0.3), (10.0, 1.0), (15.0, 0.6), (20.0, 1.0))
REFERENCE = Reference(1.0, 0.12566)

#: Table 1 of the paper, with a softer normal force than its corner at β → 0
TABLE_1 = {"kp_N_mm": 5.49, "force_zero_N": 0.0, "t1_N": 0.24, "eta1": 0.95, "g1": 0.41, "t2_N": 0.36, "eta2": 5.1,
           "g2": 0.53, "t3_N": 0.5, "eta3": 4.4, "g3": 0.06}


def numbers() -> dict[str, np.ndarray]:
    out = {k: np.array([v]) for k, v in TABLE_1.items()}
    return out | from_paper_stiffness(19.62, 30.37) | from_paper_hunt_crossley(0.6, 1.1, 0.6, REFERENCE)


def record(frequency_hz, amplitude_mm, force_N, noise_N=0.0, seed=0, cycles=8, name=None):
    """A record whose every cycle is the loop force_N (samples,), with white noise."""
    n = len(force_N) * cycles
    time = np.arange(n) / (len(force_N) * frequency_hz)
    noise = np.random.default_rng([seed, int(1000 * frequency_hz * amplitude_mm)]).standard_normal(n)
    return Record(name or f"f{frequency_hz:g}_a{amplitude_mm:g}.csv", frequency_hz, amplitude_mm, "fit", {}, time,
                  amplitude_mm * np.sin(2 * np.pi * frequency_hz * time), np.tile(force_N, cycles) + noise_N * noise)


def loops(noise_N=0.02, seed=0, n_phase=128, tests=TESTS, model=None, values=None):
    model = Model(REFERENCE) if model is None else model
    motion = sine_motion([a for _, a in tests], [f for f, _ in tests])
    force = model.force(numbers() if values is None else values, motion)[0]
    return tuple(average(record(f, a, row, noise_N, seed), n_phase=n_phase) for (f, a), row in zip(tests, force))


def true_z(problem, values=None, **noise):
    """Coordinates of the known numbers in a problem made from their loops (whose reference scales differ a little)."""
    n = dict(numbers() if values is None else values)
    if "beta" in n:
        s = problem.model.reference
        length = s.length_mm / REFERENCE.length_mm
        n["grip_slope"] = n["grip_slope"] * length ** n["beta"]
        n["grip_rate"] = n["grip_rate"] * length ** n["beta"] * s.speed_m_s / REFERENCE.speed_m_s
    default = {"noise_scale": 1.0, "discrepancy_share": 1e-4, "discrepancy_length": 0.06, "noise_N": 0.02}
    return problem.prior.scores(defaults.sampled_values(problem.model, n) | default | noise)


@pytest.fixture(scope="session")
def known():
    """Functions and numbers of this file, for the tests."""
    class Known:
        pass

    out = Known()
    out.loops, out.record, out.numbers, out.true_z = loops, record, numbers, true_z
    out.reference, out.tests = REFERENCE, TESTS
    return out


@pytest.fixture(scope="session")
def problem():
    return make_problem(loops())
