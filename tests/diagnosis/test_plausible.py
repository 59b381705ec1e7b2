"""Numbers that no cause has."""

import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.diagnosis.assessment import indicators
from bayes_iwan.diagnosis.assessment.assessed_search import assessed
from bayes_iwan.diagnosis.assessment.calibration import calibration
from bayes_iwan.diagnosis.assessment.indicators import figures_of, implausible, of_time, replaced
from bayes_iwan.diagnosis.assessment.verdict import verdict_of
from bayes_iwan.diagnosis.constants import CLOCK_SPREAD, LARGEST_SCORE, LONGEST_PERIODS
from bayes_iwan.diagnosis.fits.evidence import base_problem
from bayes_iwan.effects import catalogue


def data_of(kit, *hz):
    loops = kit.made_up(kit.specimen_force, [(f, a) for f in hz for a in (0.4, 0.9)], cycles=5).loops(**kit.small)
    return SimpleNamespace(loops=loops)


def fit_with(kit, data, effect, **values):
    """A fit of the base with an effect whose numbers have these values, by short name."""
    problem = base_problem(data, kit.settings, kit.scales).with_effects([effect])
    z = np.zeros(problem.ndim)
    for name, value in values.items():
        at = problem.names.index(f"{effect.name}.{name}")
        grid = np.linspace(-6.0, 6.0, 4001)
        trial = np.zeros((len(grid), problem.ndim))
        trial[:, at] = grid
        found = problem.prior.values(trial)[f"{effect.name}.{name}"]
        z[at] = grid[np.argmin(np.abs(found - value))]
    return SimpleNamespace(problem=problem, z=z)


def effect_of(kit, name):
    return catalogue.variants()[name][0](kit.scales, ("t0.csv",))


@pytest.mark.parametrize(
    ("law", "refused"), [("channel_delay", True), ("normal_force_lag", True), ("spring_softening", False)]
)
def test_a_time_constant_beyond_the_tested_periods_is_none(kit, law, refused):
    """Also of a lag with a transient along the record; softening may take as long as it wants."""
    laws = catalogue.variants()[law]
    effect = next(e for e in (k(kit.scales, ("t0.csv",)) for k in laws) if e.evolving or law == "channel_delay")
    slow = SimpleNamespace(loops=[SimpleNamespace(frequency_hz=f, amplitude_mm=1.0) for f in (8.0, 20.0)])
    names = tuple(p.name for p in effect.parameters)
    for periods, beyond in ((0.1, False), (1.1 * LONGEST_PERIODS, True)):
        values = {n: np.array([periods / 8.0]) for n in names}
        fit = SimpleNamespace(
            z=np.zeros(len(names)),
            problem=SimpleNamespace(names=names, prior=SimpleNamespace(values=lambda z, v=values: v)),
        )
        assert ("longer than" in implausible(effect, fit, slow)) == (beyond and refused)


def test_an_effect_of_time_needs_frequencies_that_differ(kit):
    effect = effect_of(kit, "channel_delay")
    assert of_time(effect) and not of_time(effect_of(kit, "cubic_stiffness"))
    alike, apart = data_of(kit, 10.0, 10.0 * (CLOCK_SPREAD - 0.05)), data_of(kit, 10.0, 10.0 * (CLOCK_SPREAD + 0.1))
    assert "follows frequency" in implausible(effect, fit_with(kit, alike, effect, delay_s=2e-4), alike)
    assert implausible(effect, fit_with(kit, apart, effect, delay_s=2e-4), apart) == ""
    one_speed = SimpleNamespace(loops=[x for x in apart.loops if (x.frequency_hz < 10.5) == (x.amplitude_mm > 0.5)])
    assert len(one_speed.loops) == 2
    assert "follows frequency" in implausible(effect, fit_with(kit, one_speed, effect, delay_s=2e-4), one_speed)


def test_a_number_far_from_its_prior_is_not_plausible_but_towards_an_end_of_its_range(kit):
    """A memory may be of any shortness, and the coefficients of a series, which are strengths, of any size."""
    data, far = data_of(kit, 8.0, 20.0), LARGEST_SCORE + 0.1
    for law, number, z, refused in (
        ("rate_strengthening", "memory_s", far, True),
        ("rate_strengthening", "memory_s", -far, False),
        ("end_stop", "exponent", far, True),
        ("slip_forces_free", "c4", far, False),
    ):
        effect = effect_of(kit, law)
        fit = fit_with(kit, data, effect)
        assert implausible(effect, fit, data) == ""
        fit.z[fit.problem.names.index(f"{law}.{number}")] = z
        assert (number in implausible(effect, fit, data)) == refused


def test_numbers_must_be_plausible_where_they_and_where_shares_are_from(kit, monkeypatch):
    found = kit.diagnosed("channel_delay").found
    search, whole = found.search, frozenset(found.search.chosen)
    best, nearest, name = found.models.fits[whole], found.models.nearest[whole], search.chosen[0]
    strength = next(e for e in best.effects if e.name == name).strength_name
    delay = np.array([n == strength for n in best.problem.names])

    def far(fit):
        return replace(fit, z=np.where(delay, 8.0, fit.z))

    def delay_s(fit):
        return abs(float(fit.problem.prior.values(fit.z[None])[strength][0]))

    least = max(delay_s(best), delay_s(nearest))
    assert delay_s(far(best)) > 2.0 * least
    slowest_hz = min(x.frequency_hz for x in search.data.loops)
    monkeypatch.setattr(indicators, "LONGEST_PERIODS", 1.5 * least * slowest_hz)

    for one, other in ((best, nearest), (far(best), nearest), (best, far(nearest))):
        given = replace(search, fits=dict(search.fits) | {whole: one})
        odd = {f.name: f.odd for f in figures_of(given, found.models.sizes, other, found.held_out)}
        assert bool(odd[name]) == (one is not best or other is not nearest)


def test_of_no_gap_an_effect_removes_nothing(kit):
    """A gap beyond noise is often exactly nothing on a sound specimen."""
    found = kit.diagnosed("viscous_damping").found
    base = found.models.sizes[frozenset()]
    sizes = {**found.models.sizes, frozenset(): replace(base, all=replace(base.all, rms_N=0.0, low_N=0.0))}
    nearest = found.models.nearest[frozenset(found.search.chosen)]
    assert all(f.fitted == f.alone == 0.0 for f in figures_of(found.search, sizes, nearest, found.held_out))


def test_what_only_changes_from_cycle_to_cycle_must_explain_such_a_change(kit):
    """Its powers of amplitude and frequency would else stand for any law of the amplitude."""
    found = kit.diagnosed("friction_fade").found
    whole = frozenset(found.search.chosen)
    nearest = found.models.nearest[whole]

    def odd(sizes):
        return {f.name: f.odd for f in figures_of(found.search, sizes, nearest, found.held_out)}["friction_fade"]

    assert odd(found.models.sizes) == ""
    less = whole - {"friction_fade"}
    steady = replace(found.models.sizes[less], along=found.models.sizes[whole].along)
    assert "does not change from cycle to cycle" in odd({**found.models.sizes, less: steady})


@pytest.mark.parametrize(
    ("without", "beside", "owner", "why"),
    [(4.5, 1.0, "", "k1_N_mm"), (4.5, 4.2, "", ""), (2.0, 0.0, "", ""), (4.5, 1.0, "another effect", "")],
)
def test_an_effect_that_only_replaces_a_number_of_the_base_is_no_cause(without, beside, owner, why):
    def fit(z):
        free = (SimpleNamespace(name="kp_N_mm", owner=""), SimpleNamespace(name="k1_N_mm", owner=owner))
        problem = SimpleNamespace(names=("kp_N_mm", "k1_N_mm"), prior=SimpleNamespace(free=free))
        return SimpleNamespace(problem=problem, z=np.array([0.0, z]))

    said = replaced(fit(without), fit(beside))
    assert why in said and bool(said) is bool(why)


def test_where_the_base_misses_no_more_than_noise_may_make_nothing_is_named(kit):
    found = kit.diagnosed("viscous_damping", "held out").found
    assert verdict_of(found, calibration()).names == ("viscous_damping",)
    models = copy.copy(found.models)
    base = models.sizes[frozenset()]
    models.sizes = models.sizes | {frozenset(): replace(base, all=replace(base.all, low_N=0.0))}
    quiet = assessed(found.search, models, found.held_out)
    assert "no more than noise" in quiet.figures[0].odd
    verdict = verdict_of(quiet, calibration())
    assert verdict.names == () and verdict.one_of == () and verdict.suspects == ()
