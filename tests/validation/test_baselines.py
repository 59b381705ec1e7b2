"""Baselines: each finds what it can find, and answers in the words of a diagnosis."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayes_iwan.campaign import read_campaign
from bayes_iwan.effects import catalogue
from bayes_iwan.gap.data import gap_data, predicted
from bayes_iwan.gap.evidence import base_problem, extended, fit_model
from bayes_iwan.gap.search import Search
from bayes_iwan.gap.strength import calibrated
from bayes_iwan.inference.scales import scales_of
from bayes_iwan.validation import baselines

DATA = Path(__file__).parents[2] / "data" / "rope_spring"
KINDS = ("viscous_damping", "direction_dependent_friction", "moving_mass", "cubic_stiffness")


@pytest.fixture(scope="module")
def base():
    """Three tests, a base model fitted roughly, and effects at their typical strength."""
    campaign = read_campaign(DATA)
    loops = replace(campaign, tests=tuple(campaign.tests[i] for i in (0, 4, 8))).loops(n_phase=80, n_harmonics=24)
    data, scales = gap_data(loops), scales_of(loops)
    problem = base_problem(data, {}, scales)
    fit = fit_model(data, problem, np.zeros((1, problem.ndim)), iterations=4)
    effects = {n: tuple(calibrated(k, scales, data, problem, fit.z) for k in catalogue.variants()[n]) for n in KINDS}
    return data, scales, fit, effects


def with_effect(data, fit, effect, seed=0):
    """The data that the fitted model with this effect would give, and noise as measured."""
    problem = extended(fit.problem, (effect,))
    z = np.zeros(problem.ndim)
    z[[problem.names.index(n) for n in fit.problem.names]] = fit.z
    z[problem.names.index(effect.strength_name)] = 0.7
    rng = np.random.default_rng(seed)
    noise = np.stack([np.where(np.isfinite(x.noise_N), x.noise_N, 0.0) for x in data.loops])
    noise = noise * (rng.standard_normal(noise.shape) + 1j * rng.standard_normal(noise.shape))
    return replace(data, harmonics_N=predicted(data, problem, z[None])[0][0] + noise)


def test_uniform_guess_knows_nothing():
    drawn = [baselines.uniform_guess(KINDS, np.random.default_rng(i)) for i in range(300)]
    assert drawn[0]["probabilities"] == dict.fromkeys(("none", "unknown", *KINDS), pytest.approx(1 / 6))
    causes = [a["verdict"]["cause"] for a in drawn]
    assert all(25 < causes.count(n) < 80 for n in ("none", "unknown", *KINDS))


@pytest.mark.parametrize("name", KINDS)
def test_correlation_finds_a_residual_that_is_a_signature(base, name):
    data, _, fit, effects = base
    answer = baselines.correlation(with_effect(data, fit, effects[name][0]), fit, effects)
    assert answer["verdict"]["cause"] == name
    assert sum(answer["probabilities"].values()) == pytest.approx(1.0)


def test_correlation_says_none_to_noise_and_unknown_to_what_resembles_nothing(base):
    data, _, fit, effects = base
    exact = predicted(data, fit.problem, fit.z[None])[0][0]
    assert baselines.correlation(replace(data, harmonics_N=exact), fit, effects)["verdict"]["cause"] == "none"
    strange = exact.copy()
    strange[:, 9] += 0.5 * data.level_N
    assert baselines.correlation(replace(data, harmonics_N=strange), fit, effects)["verdict"]["cause"] == "unknown"


def test_bic_prefers_the_effect_that_made_the_data_and_pays_for_numbers(base):
    data, scales, fit, effects = base

    def refits(new):
        z = fit.z[None]
        start = fit_model(new, fit.problem, z, iterations=8)
        singles = {}
        for name in ("viscous_damping", "moving_mass"):
            problem = extended(fit.problem, effects[name])
            at = np.zeros((1, problem.ndim))
            at[0, [problem.names.index(n) for n in fit.problem.names]] = start.z
            singles[name] = (fit_model(new, problem, at, iterations=12),)
        return Search(new, scales, {}, start, singles, {}, effects)

    found = baselines.bic(refits(with_effect(data, fit, effects["moving_mass"][0])))
    assert found["verdict"]["cause"] == "moving_mass"
    assert found["probabilities"]["unknown"] == 0.0
    assert sum(found["probabilities"].values()) == pytest.approx(1.0)
    nothing = replace(effects["moving_mass"][0], strength_value=1e-12)
    exact = replace(data, harmonics_N=with_effect(data, fit, nothing).harmonics_N)
    assert baselines.bic(refits(exact))["verdict"]["cause"] == "none"
