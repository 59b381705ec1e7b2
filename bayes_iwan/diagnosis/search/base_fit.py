"""The base model alone: its fit from many starts and the gap that it leaves."""

from dataclasses import replace

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.constants import NEWTON_NATS, USUAL_GAP
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.discrepancy_size import FIRST
from bayes_iwan.diagnosis.fits.evidence import Fit, base_problem, fit_model, in_newtons
from bayes_iwan.diagnosis.fits.gap_size import GapSize, gap_power_N2, gap_size
from bayes_iwan.diagnosis.fits.residual_rows import Rows
from bayes_iwan.diagnosis.fits.residuals import residual_of
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.inference.setup.simulator_check import check_simulator
from bayes_iwan.models import Simulator

BASE_POINTS, BASE_STARTS = 1200, 32
#: draws of the noise behind each gap
DRAWS = 100
#: iterations behind a quick gap
QUICK_STEPS = 6


def fit_base(
    data: GapData,
    settings: DiagnoseSettings,
    scales: Scales,
    rng: np.random.Generator,
    simulator: Simulator | None = None,
) -> Fit:
    """The base model from the best of many prior draws."""
    problem = base_problem(data, settings, scales, simulator)
    if simulator is not None:
        check_simulator(problem)
    draws = problem.prior.draw(rng, BASE_POINTS)
    return fit_model(data, problem, cheapest(data, problem, draws, BASE_STARTS))


def cheapest(data: GapData, problem: Problem, z: Array, most: int) -> Array:
    """(most, ndim) those of the points z (n, ndim) that cost least."""
    rows = Rows(data, problem)
    cost = np.sum((rows.residual(z) / rows.sd(replace(FIRST, share=0.05))) ** 2, axis=1) + np.sum(z * z, axis=1)
    return z[np.argsort(np.where(np.isfinite(cost), cost, np.inf))[:most]]


def gap_of(data: GapData, fit: Fit) -> GapSize:
    """The gap that a fit's model leaves where it misses least."""
    return gap_size(residual_of(data, in_newtons(data, fit)), draws=DRAWS)


def gap_rms_N(data: GapData, fit: Fit) -> float:
    """The same, RMS, N."""
    return gap_of(data, fit).all.rms_N


def quick_gap_N(data: GapData, fit: Fit) -> float:
    """The same within a few per cent, for half the work: few steps, and no draws of the noise."""
    residual = residual_of(data, in_newtons(data, fit, QUICK_STEPS))
    return float(np.sqrt(max(float(gap_power_N2(residual).mean()), 0.0)))


def sound_gap_N(data: GapData) -> float:
    """By so much a sound specimen differs from the model, RMS, N."""
    return USUAL_GAP * float(np.sqrt(np.mean(data.level_N**2)))


def newton_nats(gap_N: float, sound_N: float, tests: int) -> float:
    """What a gap in newtons counts beside the evidence; sound_N : a sound specimen's usual one.

    Evidence follows the harmonics that are quiet, and takes tests together for what is smooth between them: a law that
    fits what is small in newtons may win there while another halves the gap. So a gap counts as evidence would count it
    that knew one harmonic of each test and nothing of the other tests: by ln of its square, once a test.
    """
    return -0.5 * NEWTON_NATS * tests * float(np.log(gap_N**2 + sound_N**2))
