"""What an effect makes, taken out of the records: against records that were made without it."""

import numpy as np
import pytest

from bayes_iwan.effects.catalogue import variants
from bayes_iwan.gap.fitting.data import gap_data
from bayes_iwan.gap.fitting.evidence import base_problem, extended, fit_model, in_newtons
from bayes_iwan.gap.judging.budget import Share
from bayes_iwan.gap.judging.taken_out import both_ways, data_without, gaps_without
from bayes_iwan.gap.searching.base import gap_rms_N

TESTS = [(8.0, 0.4), (8.0, 0.9), (16.0, 0.4), (16.0, 0.9)]
C_N_S_MM, RATE_N_S = 0.004, 0.1
DAMPING, DRIFT = frozenset({"viscous_damping"}), frozenset({"force_drift"})


@pytest.fixture(scope="module")
def records(kit):
    """Data of Table 1's specimen with a dashpot and a drift, by which of them were there."""

    def of(which):
        def force(frequency, amplitude, samples):
            phase = 2.0 * np.pi * np.arange(samples) / samples
            dashpot = C_N_S_MM * 2.0 * np.pi * frequency * amplitude * np.cos(phase)
            return kit.specimen_force(frequency, amplitude, samples) + (DAMPING <= which) * dashpot

        drift = (lambda time, test: RATE_N_S * time) if DRIFT <= which else None
        return gap_data(kit.made_up(force, TESTS, noise_N=0.01, extra=drift).loops(**kit.small))

    return {k: of(k) for k in (DAMPING | DRIFT, DAMPING, DRIFT, frozenset())}


@pytest.fixture(scope="module")
def fits(kit, records):
    """The base model and the whole one, fitted to the data of both, where they miss least in newtons."""
    data = records[DAMPING | DRIFT]
    base = base_problem(data, kit.settings, kit.scales)
    kinds = variants()
    effects = [kinds[n][0](kit.scales, tuple(x.file for x in data.loops)) for n in ("viscous_damping", "force_drift")]
    found = {}
    for key, problem in ((frozenset(), base), (DAMPING | DRIFT, extended(base, effects))):
        starts = problem.prior.draw(np.random.default_rng(3), 12)
        found[key] = in_newtons(data, fit_model(data, problem, starts))
    return found


@pytest.mark.parametrize("out", [DAMPING, DRIFT, DAMPING | DRIFT])
def test_what_is_left_is_what_would_have_been_measured_without(records, fits, out):
    whole = records[DAMPING | DRIFT]
    less, made_so = data_without(whole, fits[DAMPING | DRIFT], out), records[(DAMPING | DRIFT) - out]
    for part in ("harmonics_N", "trend_N"):
        there = np.abs(getattr(whole, part) - getattr(made_so, part)).max()
        np.testing.assert_allclose(getattr(less, part), getattr(made_so, part), atol=0.12 * there)


def test_gaps_are_the_base_models_of_such_records(records, fits):
    whole = records[DAMPING | DRIFT]
    gap_N = gaps_without(whole, fits[frozenset()], fits[DAMPING | DRIFT], [frozenset(), DAMPING, DRIFT])
    assert gap_N[frozenset()] == pytest.approx(gap_rms_N(whole, fits[frozenset()]), rel=0.05)
    for out in (DAMPING, DRIFT):
        made_so = records[(DAMPING | DRIFT) - out]
        problem = fits[frozenset()].problem
        alone = fit_model(made_so, problem, problem.prior.draw(np.random.default_rng(3), 12))
        assert gap_N[out] == pytest.approx(gap_rms_N(made_so, alone), abs=0.1 * gap_N[frozenset()])


def test_the_mean_of_both_ways_sums_to_what_all_remove_together():
    put_in = {"a": Share(0.5, 0.3, 0.7), "b": Share(0.3, 0.2, 0.4)}
    left = {frozenset(): 2.0, frozenset("a"): 1.4, frozenset("b"): 1.0, frozenset("ab"): 0.2}
    # taken out: a 0.3 first and 0.4 last, b 0.5 and 0.6; together 0.9 of the gap, put in only 0.8
    found = both_ways(put_in, left)
    assert found["a"].value == pytest.approx(0.5 + 0.5 * (0.35 - 0.5) - 0.025)
    assert found["b"].value == pytest.approx(0.3 + 0.5 * (0.55 - 0.3) - 0.025)
    assert sum(s.value for s in found.values()) == pytest.approx(0.8)
    assert found["a"].high - found["a"].low == pytest.approx(0.4)
    alone = {"a": Share(0.5, 0.3, 0.7)}
    assert both_ways(alone, {}) == alone  # nothing to share it with
