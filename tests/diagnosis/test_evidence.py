"""Evidence: Laplace's approximation where it is exact, and one scale for steady and evolving models."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.campaign import average
from bayes_iwan.diagnosis.answer.saved_fits import LOOPS
from bayes_iwan.diagnosis.assessment import sampled_fit
from bayes_iwan.diagnosis.assessment.calibration import calibration
from bayes_iwan.diagnosis.constants import LARGE_DISCREPANCY
from bayes_iwan.diagnosis.fits import evidence
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.fits.discrepancy_size import BETWEEN, LENGTHS, SHARES, Discrepancy, DiscrepancySize, Linear
from bayes_iwan.diagnosis.fits.evidence import _distinct, _grid, _whole_share, fit_model, in_newtons, predicting
from bayes_iwan.diagnosis.fits.gap_size import gap_power_N2
from bayes_iwan.diagnosis.fits.residual_rows import Rows
from bayes_iwan.diagnosis.fits.residuals import residual_of
from bayes_iwan.diagnosis.search.base_fit import fit_base, gap_rms_N
from bayes_iwan.diagnosis.search.fitted_sets import calibrated
from bayes_iwan.effects import catalogue
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.sampling.run import EnsembleRun


@pytest.fixture
def toy():
    """A model of four numbers, linear about where it stands, and a rest of which a part changes along the record."""
    rng = np.random.default_rng(5)
    discrepancy = Discrepancy(rng.uniform(0.0, 400.0, 30), rng.integers(0, 6, 30), np.arange(30) >= 24)
    return Linear(rng.standard_normal(30), 3.0 * rng.standard_normal((30, 4)), discrepancy, rng.standard_normal(4))


def really(linear, bend=0.0):
    """Rows of a model whose residual departs from its linear one by `bend` times the square of the step."""
    away = np.ones(len(linear.residual))

    def residual(z):
        step = z - linear.z
        return linear.residual - step @ linear.jacobian.T + bend * np.sum(step**2, axis=1)[:, None] * away

    return SimpleNamespace(residual=residual)


def test_grid_finds_the_best_point_and_averages_over_the_change_along_the_record(toy):
    grid = _grid(really(toy), toy)
    assert grid.log_z.shape == (len(SHARES), len(LENGTHS))
    along = grid.size.along
    one = np.array([[toy.evidence(((a, b, along),)).log_z[0] for b in LENGTHS] for a in SHARES])
    np.testing.assert_allclose(np.ptp(grid.log_z - one), 0.0, atol=1e-9)  # the average is one constant
    i, k = np.unravel_index(np.argmax(one), one.shape)
    assert (grid.size.share, grid.size.length) == (SHARES[i], LENGTHS[k])
    low, middle, high = sorted(grid.discrepancy_share)
    assert grid.discrepancy_share == (middle, low, high) and low < high


def test_a_discrepancy_as_large_as_the_friction_is_unlikely_beforehand(toy):
    """Rows without any discrepancy: what is left of the evidence is its prior, 1/(1 + (share/LARGE_DISCREPANCY)²)."""
    bare = replace(toy, discrepancy=replace(toy.discrepancy, eigen=np.zeros(30)))
    log_z = [bare.evidence(((share, float(LENGTHS[0]), 0.0),)).log_z[0] for share in (1e-9, LARGE_DISCREPANCY, 1.0)]
    np.testing.assert_allclose(
        np.subtract(log_z, log_z[0]), [0.0, -np.log(2.0), -np.log1p(LARGE_DISCREPANCY**-2)], rtol=1e-9
    )


@pytest.mark.parametrize("bend", [30.0, np.inf])
def test_evidence_is_of_what_a_model_misses_and_not_of_what_its_linear_one_promises(toy, bend):
    """Where the step leads nowhere, or where there is no force, the model stays; a slight bend costs what it costs."""
    straight, bent = _grid(really(toy), toy), _grid(really(toy, bend), toy)
    assert bent.log_evidence < straight.log_evidence - 1.0
    np.testing.assert_array_equal(bent.z, toy.z)
    size = ((bent.size.share, bent.size.length, bent.size.along),)
    stays = toy.at(toy.residual[None], toy.z[None], size, bent.precision[None])
    assert bent.size == stays.sizes[0]
    slight = _grid(really(toy, 1e-4), toy)
    assert straight.log_evidence - 1.0 < slight.log_evidence < straight.log_evidence


@pytest.mark.parametrize("cause", [None, "viscous_damping"])
def test_a_fit_stands_where_its_evidence_is(kit, cause):
    """At its own size of the discrepancy no step promises more than a nat or two."""
    search = kit.diagnosed(cause, *(() if cause is None else ("grid",))).search
    for fit in (search.base, search.fit(search.chosen)):
        sd = np.sqrt(fit.linear.variance(fit.size))
        j, r = fit.linear.jacobian / sd[:, None], fit.linear.residual / sd
        b = j.T @ r - fit.z
        assert 0.5 * b @ np.linalg.solve(j.T @ j + np.eye(len(b)), b) < 2.0, fit.name


def test_a_larger_model_misses_no_more_in_newtons_than_a_smaller_one(kit):
    """From where evidence left it it may arrive nowhere; the smaller model's place is a start as good."""
    search = kit.diagnosed("viscous_damping", "grid").search
    base = in_newtons(search.data, search.base)
    lost = np.full(len(search.fit(search.chosen).z), 2.5)
    astray = replace(search.fit(search.chosen), z=lost, optima=lost[None])

    def missed_N2(fit):
        return float(np.mean(gap_power_N2(residual_of(search.data, fit, refitted=False))))

    astray = replace(astray, linear=Rows(search.data, astray.problem, astray.size.between).linear(lost))
    alone = in_newtons(search.data, astray, iterations=1)
    beside = in_newtons(search.data, astray, iterations=1, smaller=[base])
    assert missed_N2(beside) < 0.5 * missed_N2(alone)


def test_evidence_is_the_mean_over_the_grid_and_the_discrepancy_has_its_size(kit):
    fit = kit.diagnosed(None).search.base
    assert fit.log_evidence == pytest.approx(np.log(np.mean(np.exp(fit.log_z - fit.log_z.max()))) + fit.log_z.max())
    middle, low, high = fit.discrepancy_share
    assert SHARES[0] <= low < middle < high <= SHARES[-1] and middle < 0.01


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_the_share_of_the_discrepancy_is_between_those_that_are_as_likely(factor):
    """1 and 4 % alike likely: the median is between them in logarithms; λ of 4 in every harmonic doubles all three."""
    sizes = tuple(DiscrepancySize(share, 0.05, 0.0, (factor,) * 7) for share in (0.04, 0.01))
    found = SimpleNamespace(sizes=sizes, log_z=np.array([-3.0, -3.0]))
    assert _whole_share(7, found) == pytest.approx(np.array([0.02, 0.01, 0.04]) * np.sqrt(factor))


def test_distinct_optima_best_first():
    """One beside the best, its mirror image, one that costs too much, and more than the four that are kept."""
    x = np.array([[0.7, -0.4], [0.8, -0.4], [-0.7, 0.4], [0.7, 4.6], [1.7, -0.4], [2.7, -0.4], [3.7, -0.4]])
    np.testing.assert_array_equal(_distinct(x, np.array([1.0, 2.0, 3.0, 99.0, 4.0, 5.0, 6.0])), x[[0, 2, 4, 5]])


def test_a_large_discrepancy_does_not_lead_a_model_away_from_what_it_can_fit(measured):
    """A seal's loop at 7 bar: beside a rest of 180 % of the friction force priors alone decide, and the base model was
    said to miss half of a force that it fits to a tenth."""
    loops = [average(x, **LOOPS) for x in measured("pneumatic_seal").tests if x.file == "p7bar.csv"]
    data, scales = gap_data(loops), scales_of(loops)
    level = float(np.sqrt(np.mean(data.level_N**2)))
    for seed in (1, 2):
        base = fit_base(data, DiagnoseSettings(), scales, np.random.default_rng(seed))
        assert gap_rms_N(data, base) < 0.1 * level
    far = replace(base, z=np.zeros_like(base.z), discrepancy_share=(1.8, 0.2, 2.2))
    assert gap_rms_N(data, far) < 0.1 * level  # wherever evidence left it
    held = predicting(data, far, in_newtons(data, far))
    assert held.size.share == 1.8 and np.linalg.norm(held.z) < np.linalg.norm(in_newtons(data, far).z)


@pytest.mark.parametrize("name", ["friction_fade", "force_drift", "mains_interference"])
def test_idle_evolving_effect_costs_what_the_steady_model_pays(name, kit):
    """A steady model misses all trends and lines; an evolving one that is switched off misses the same."""
    found = kit.diagnosed(None).search
    effect = found.effects[name][0]
    problem = found.base.problem.with_effects([effect])
    rows, steady = Rows(found.data, problem), Rows(found.data, found.base.problem)
    z = np.zeros((1, problem.ndim))
    z[0, [problem.names.index(n) for n in found.base.problem.names]] = found.base.z
    if not effect.signed and effect.strength_name in problem.names:
        z[0, problem.names.index(effect.strength_name)] = -8.0  # a thousandth of the typical
    idle, base = rows.residual(z)[0], steady.residual(found.base.z[None])[0]
    np.testing.assert_allclose(idle[: len(base)], base, atol=0.5)
    assert rows.layout.constant == 0.0
    assert 0.5 * np.sum(idle[len(base) :] ** 2) == pytest.approx(
        steady.layout.steady_cost(DiscrepancySize(0.0, 0.1, 0.0)), rel=0.03
    )


@pytest.mark.parametrize("name, most", [("friction_fade", 12.0), ("force_drift", 12.0)])
def test_evolving_effect_that_is_not_there_loses_a_few_nats(name, most, kit):
    found = kit.diagnosed(None).search
    effect = found.effects[name][0]
    problem = found.base.problem.with_effects([effect])
    start = np.zeros((1, problem.ndim))
    start[0, [problem.names.index(n) for n in found.base.problem.names]] = found.base.z
    start[0, problem.names.index(effect.strength_name)] = 0.0 if effect.signed else -1.6
    fit = fit_model(found.data, problem, start, iterations=20)
    assert -most < fit.log_evidence - found.base.log_evidence < 2.0


def test_a_fit_is_sampled_with_the_discrepancy_beside_it(kit, monkeypatch):
    """The density is that of residuals with the discrepancy's variance; a run cut short is not converged."""
    found = kit.diagnosed(None).search
    target = sampled_fit.Target(found.data, found.base)
    rng = np.random.default_rng(1)
    z = np.concatenate([found.base.z + 0.01 * rng.standard_normal((6, len(found.base.z))), np.zeros((6, 2))], axis=1)
    z[3:, -2:] = [0.4, -0.7]
    # its share about four times a sound specimen's, its length between those of the grid
    share = 4.0 * calibration().usual[0] * np.exp(1.2 * z[:, -2])
    length = np.sqrt(LENGTHS[0] * LENGTHS[-1]) * np.exp(0.5 * z[:, -1])
    variance = target.residuals.discrepancy.variances(share, length, found.base.size)
    residual = target.residuals.residual(z[:, :-2])
    expected = np.sum(stats.norm.logpdf(residual, 0.0, np.sqrt(variance)), axis=1)
    expected += np.sum(stats.norm.logpdf(z), axis=1)
    np.testing.assert_allclose(np.diff(target(z)), np.diff(expected), rtol=1e-6, atol=1e-6)
    assert np.ptp(expected) > 0.1 and target(z + 9.0)[0] == -np.inf
    monkeypatch.setattr(sampled_fit, "BUDGET_S", 0.0)
    cut, worth = sampled_fit.sampled_fit(found.data, found.base, 1, lambda said: None)
    assert not worth.converged and worth.message and not cut.converged and np.array_equal(cut.z, found.base.z)
    assert np.all(np.linalg.eigvalsh(cut.covariance) > 0.0)


def test_mean_forces_that_do_not_fit_make_no_gap(kit):
    """They count as none. Were they met as loops are, these would leave 3.6 % of the friction force."""

    def gap(mean_N):
        some = kit.made_up(kit.specimen_force, [(f, a) for f in (8.0, 20.0) for a in (0.3, 0.6, 0.9)], noise_N=0.002,
                           extra=lambda time, i: mean_N * (i % 3) ** 2 + 0.0 * time).loops(**LOOPS)  # fmt: skip
        data = gap_data(some)
        base = fit_base(data, kit.settings, scales_of(some), np.random.default_rng(0))
        found = residual_of(data, in_newtons(data, base))
        return np.sqrt(max(gap_power_N2(found).mean(), 0.0)) / data.level_N.mean()

    assert gap(0.0) < 0.001 and gap(0.3) < 0.005


def test_ctrl_c_ends_a_diagnosis_while_it_samples(kit, monkeypatch):
    """The sampler ends with what it drew, here nothing; a diagnosis that goes on without would be no answer to it."""

    def interrupted(*given):
        raise KeyboardInterrupt

    monkeypatch.setattr(EnsembleRun, "block", interrupted)
    found = kit.diagnosed(None).search
    with pytest.raises(KeyboardInterrupt):
        sampled_fit.sampled_fit(found.data, found.base, 1, lambda said: None)


def test_sampling_a_fit_converges_near_its_normal_approximation(kit):
    found = kit.diagnosed(None).search
    fit, worth = sampled_fit.sampled_fit(found.data, found.base, 1, lambda said: None)
    assert fit.converged and worth.converged
    assert worth.least_ess >= 400.0 and worth.worst_r_hat <= 1.01
    sd, laplace = np.sqrt(np.diag(fit.covariance)), np.sqrt(np.diag(found.base.covariance))
    assert np.median(sd / laplace) == pytest.approx(1.0, abs=0.35) and np.all(np.abs(fit.z - found.base.z) < 4.0 * sd)


def test_a_discrepancy_that_is_the_same_at_every_frequency_does_not_hide_what_differs_between_them(kit, monkeypatch):
    """Friction that varies along the stroke, as a groove makes it, beside a small mass: in which tests the discrepancy
    is alike is learnt from them, and what is left of it between frequencies is far smaller than it is."""
    tests = [(f, a) for f in (8.0, 10.0, 16.0, 20.0) for a in (0.4, 0.9)]

    def force(frequency, amplitude, samples):
        phase = 2.0 * np.pi * np.arange(samples) / samples
        u, speed = amplitude * np.sin(phase), np.cos(phase)
        groove = 0.5 * np.cos(6.0 * u + 1.0) * np.tanh(8.0 * speed)
        return kit.specimen_force(frequency, amplitude, samples) + groove - 0.2 * (frequency / 20.0) ** 2 * u

    loops = kit.made_up(force, tests, noise_N=0.01, cycles=12).loops(**kit.small)
    data, scales = gap_data(loops), scales_of(loops)
    gain, between = {}, {}
    for ways in (BETWEEN[:1], BETWEEN):
        monkeypatch.setattr(evidence, "BETWEEN", ways)
        base = fit_base(data, kit.settings, scales, np.random.default_rng(0))
        mass = calibrated(catalogue.variants()["moving_mass"][0], scales, data, base.problem, base.z)
        problem = base.problem.with_effects([mass])
        start = np.zeros(problem.ndim)
        start[[problem.names.index(n) for n in base.problem.names]] = base.z
        gain[len(ways)] = fit_model(data, problem, start[None]).log_evidence - base.log_evidence
        between[len(ways)] = base.size.between
    assert between[len(BETWEEN)][2] < 0.1  # next to nothing of it belongs to single tests
    assert gain[len(BETWEEN)] > gain[1] + 5.0
