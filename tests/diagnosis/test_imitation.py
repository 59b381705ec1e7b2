"""What the base can imitate: a dashpot behind the normal force's speed term, and what these tests tell apart."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign.recording.limits import RigLimits
from bayes_iwan.diagnosis.answer import imitation
from bayes_iwan.diagnosis.answer.imitation import (
    FREEDOMS,
    Explanation,
    _distinguished,
    _explains,
    _shown,
    edges_of,
    imitations,
)
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.search.base_fit import fit_base
from bayes_iwan.diagnosis.search.fitted_sets import calibrated
from bayes_iwan.diagnosis.search.search_result import Search
from bayes_iwan.effects import catalogue
from bayes_iwan.inference.setup.loop_scales import scales_of

TESTS = [(8.0, 0.3), (8.0, 0.9), (20.0, 0.3), (20.0, 0.9)]


def searched(kit, force, noise_N):
    """The base alone, fitted, with the effects that a freedom may stand for on offer."""
    data = gap_data(kit.made_up(force, TESTS, noise_N=noise_N).loops(**kit.small))
    scales = scales_of(data.loops)
    base = fit_base(data, kit.settings, scales, np.random.default_rng(1))
    kinds = catalogue.variants((), base.problem.model, {})
    effects = {
        n: tuple(calibrated(k, scales, data, base.problem, base.z) for k in kinds[n])
        for n in dict.fromkeys(n for f in FREEDOMS for n in f.effects)
    }
    return Search(data, scales, kit.settings, {frozenset(): base}, (), {}, effects)


def friction(amplitude, samples, level, stiffness):
    """One cycle of an element that sticks, then slides."""
    u = amplitude * np.sin(2 * np.pi * np.arange(2 * samples) / samples)
    z = np.zeros_like(u)
    for i in range(1, u.size):
        z[i] = np.clip(z[i - 1] + stiffness * (u[i] - u[i - 1]), -level, level)
    return z[samples:], u[samples:]


@pytest.fixture(scope="module")
def damper(kit):
    """Friction of 1.2 N and a dashpot of up to 1.1 N beside a spring."""

    def force(frequency, amplitude, samples):
        z, u = friction(amplitude, samples, 1.2, 40.0)
        omega = 2 * np.pi * frequency
        v = omega * amplitude * np.cos(2 * np.pi * np.arange(samples) / samples)
        return z + 3.0 * u + 0.01 * v

    return searched(kit, force, 0.01)


def test_a_dashpot_that_the_base_takes_up_is_found_as_speed_dependence(damper):
    level = float(np.sqrt(np.mean(damper.data.level_N**2)))
    found = {x.name: x for x in imitations(damper, {}, frozenset(), level, RigLimits())}
    speed = found["speed_dependent_normal_force"]
    assert "viscous_damping" in speed.tied and speed.said == (len(speed.tied) > 1)
    shares = {x.name: x.share for x in speed.explanations}
    assert speed.without > 2.0 * min(shares.values())
    assert list(shares.values()) == sorted(shares.values())


def test_between_two_that_explain_the_gap_alike_a_further_test_is_planned(damper, monkeypatch):
    """As if no number of nats told them apart: of those that do half of what the best does, the first two."""
    monkeypatch.setattr(imitation, "TELLS_NATS", np.inf)
    level = float(np.sqrt(np.mean(damper.data.level_N**2)))
    (speed,) = (x for x in imitations(damper, {}, frozenset(), level, RigLimits()) if x.what == "speed dependence")
    run = [(x.frequency_hz, x.amplitude_mm) for x in damper.data.loops]
    plan = speed.next_test
    assert len(speed.tied) > 1 and speed.said
    assert plan.separates == speed.tied[:2] and plan.expected_log_odds > 0.4
    assert (
        plan.bench
        or min(max(abs(np.log(plan.frequency_hz / f)), abs(np.log(plan.amplitude_mm / a))) for f, a in run) > 0.04
    )


def test_beside_a_named_effect_the_freedom_is_still_asked(damper):
    """The base without the dashpot is what the freedom is asked of, whether the dashpot is named or not."""
    level = float(np.sqrt(np.mean(damper.data.level_N**2)))
    named = imitations(damper, {}, frozenset({"viscous_damping"}), level, RigLimits())
    assert named == imitations(damper, {}, frozenset(), level, RigLimits())


def test_the_base_s_own_speed_term_is_told_from_a_dashpot(kit):
    """Table 1's specimen: loops of the base itself, at two frequencies and amplitudes."""
    found = searched(kit, kit.specimen_force, 0.003)
    level = float(np.sqrt(np.mean(found.data.level_N**2)))
    speed = [x for x in imitations(found, {}, frozenset(), level, RigLimits()) if x.what == "speed dependence"]
    assert all("speed_dependent_normal_force" in x.tied and x.explanations[0].name == x.name for x in speed)


def test_parameters_at_the_edge_are_found(damper):
    base = damper.base
    z = base.z.copy()
    z[base.problem.names.index("normal_force_rate")] = 3.6
    z[base.problem.names.index("kp_N_mm")] = -4.2

    found = edges_of(replace(base, z=z))
    names = [x.name for x in found]
    assert {"normal_force_rate", "kp_N_mm"} <= set(names) and abs(found[0].deviations) == max(
        abs(x.deviations) for x in found
    )
    rate = next(x for x in found if x.name == "normal_force_rate")
    assert rate.value == pytest.approx(
        float(base.problem.prior["normal_force_rate"].value(np.array(3.6)))
    ) and rate.deviations == pytest.approx(3.6)


@pytest.mark.parametrize(
    ("nats", "share", "apart"),
    [(-11.0, 0.016, True), (-9.0, 0.016, False), (-11.0, 0.014, False), (-9.0, 0.014, False)],
)
def test_explanations_are_told_apart_where_evidence_and_gap_both_do(nats, share, apart):
    """By more than ten nats, and by half as much gap again: every specimen differs from any model."""
    assert _distinguished(Explanation("a", 0.0, 0.010), Explanation("b", nats, share)) == apart


@pytest.mark.parametrize(("share", "explains"), [(0.01, True), (0.029, True), (0.031, False)])
def test_an_explanation_does_at_least_half_of_what_the_best_does(share, explains):
    """Without any 0.05 of the friction is missed, with the best 0.01: half the way is 0.03."""
    assert _explains(Explanation("b", 0.0, share), Explanation("a", 0.0, 0.01), 0.05) == explains


@pytest.mark.parametrize(
    ("without", "with_it", "gained", "shown"),
    [(0.02, 0.016, 9.0, True), (0.02, 0.016, 7.0, False), (0.02, 0.018, 9.0, False), (0.002, 0.0, 9.0, False)],
)
def test_a_dependence_is_shown_where_it_gains_as_an_effect_must_and_makes_the_gap_smaller(
    without, with_it, gained, shown
):
    """By 8 nats, and 0.3 % of the friction force; by whichever explanation does."""
    freedom = Explanation("freedom", 0.0, with_it)
    assert _shown([freedom], without, gained) == shown
    assert (
        _shown([Explanation("effect", -3.0, with_it), Explanation("freedom", 0.0, without)], without, gained) == shown
    )
    assert _shown([Explanation("effect", 2.0, with_it), freedom], without, gained - 2.0) == shown
