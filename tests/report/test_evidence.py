"""Each frequency alone, leave-one-out densities, the comparison of families: known answers, known disagreements."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_iwan.cli import main
from bayes_iwan.comparison import loo
from bayes_iwan.comparison.families import CompareError, compare_families
from bayes_iwan.comparison.frequencies import compare_frequencies
from bayes_iwan.comparison.loo import smoothed_log_weights
from bayes_iwan.inference.setup.settings import LikelihoodSettings
from bayes_iwan.report.comparison_page import comparison_report, ranking_figure
from bayes_iwan.report.identification.by_frequency import frequencies_table, wander_figure, wander_rows
from bayes_iwan.report.identification.predictive_checks import loo_pit

from .conftest import SETTINGS, TESTS, TRUTH, made_posterior, made_records

TINY = {
    "search": {"members": 40, "evaluations": 600, "second_search": False, "starts": 4},
    "sampling": {"ensembles": 2, "walkers": 32, "budget_s": 4.0, "r_hat": 1.1, "ess": 50.0, "taus": 5.0, "draws": 1024},
}


def test_one_specimen_agrees_with_itself(posterior):
    found = compare_frequencies(posterior)
    assert found.overall > 0.05 and "The frequencies agree" in found.statement()
    kp = next(c for c in found.checks if c.name == "kp_N_mm")
    assert np.all(np.abs(kp.estimate - TRUTH["kp_N_mm"]) < 4 / 3.29 * (kp.high - kp.low))
    assert list(found.hz) == pytest.approx([10, 20], rel=1e-3)


def test_an_estimates_interval_is_normal_in_z(posterior):
    """So of a number with a lognormal prior it is symmetric in its logarithm, and never reaches below zero."""
    checks = {c.name: c for c in compare_frequencies(posterior, replicates=50).checks}
    for name in ("kp_N_mm", "k1_N_mm", "mean_slip_force_N"):
        c = checks[name]
        assert np.all(c.low < c.estimate) and c.low * c.high == pytest.approx(c.estimate**2, rel=1e-9)


def test_a_spring_that_changes_with_frequency_is_noticed(wandering):
    found = compare_frequencies(wandering)
    assert found.overall < 0.05 and "do not agree" in found.statement() and "kp_N_mm" in found.statement()
    kp = next(c for c in found.checks if c.name == "kp_N_mm")
    assert kp.p_value < 0.05
    assert kp.estimate[1] - kp.estimate[0] == pytest.approx(0.04 * TRUTH["kp_N_mm"], rel=0.5)
    assert "✗" in " ".join(ax.get_title(loc="right") for ax in wander_figure(found).axes)
    columns, rows = wander_rows(found)
    assert all(len(row) == len(columns) for row in rows)
    assert frequencies_table(found).csv().count("\n") > len(found.checks)


def test_tests_that_determine_no_parameter_say_so(posterior, monkeypatch):
    """The report ended in NumPy's error after the whole identification."""
    monkeypatch.setattr("bayes_iwan.comparison.frequencies.determined_names", lambda joint: ())
    found = compare_frequencies(posterior)
    assert np.isnan(found.overall) and "determine no parameter" in found.statement()


def test_one_frequency_says_so():
    alone = made_posterior(made_records(((10.0, 0.4, "fit"), (10.0, 1.0, "fit"))))
    found = compare_frequencies(alone)
    assert np.isnan(found.overall) and "one frequency" in found.statement()


@pytest.mark.parametrize("sd", [0.7, 0.85])
def test_smoothed_weights_bring_one_normal_to_another(sd):
    """Draws of N(0, sd²) weighted to N(0, 1): weights have a tail of index 1 − sd², and the weighted variance is 1."""
    x = sd * np.random.default_rng(3).standard_normal((2, 40_000))
    log_w, k = smoothed_log_weights(stats.norm.logpdf(x) - stats.norm.logpdf(x, scale=sd))
    assert np.exp(log_w).sum(axis=1) == pytest.approx(1.0)
    assert k == pytest.approx(1.0 - sd**2, abs=0.1)
    assert np.sum(np.exp(log_w) * x**2, axis=1) == pytest.approx(1.0, abs=0.1)


def test_loo_of_a_normal_mean_is_exact():
    rng = np.random.default_rng(1)
    y = rng.standard_normal(40)
    mean = y.mean() + rng.standard_normal((2, 4000)) / np.sqrt(len(y))  # posterior under a flat prior, unit noise
    found = loo.psis_loo(stats.norm.logpdf(y, mean[..., None], 1.0))
    others = (y.sum() - y) / (len(y) - 1)
    exact = stats.norm.logpdf(y, others, np.sqrt(1 + 1 / (len(y) - 1)))
    assert found.holds
    assert found.pointwise == pytest.approx(exact, abs=0.02)
    assert found.elpd == pytest.approx(exact.sum(), abs=0.1)


def test_left_out_tests_by_weights_and_by_moves(posterior, monkeypatch):
    weighted = loo.leave_tests_out(posterior)
    assert np.all(weighted.pareto_k[np.isfinite(weighted.pareto_k)] < loo.TRUSTED)
    monkeypatch.setattr(loo, "TRUSTED", -np.inf)
    moved = loo.leave_tests_out(posterior, steps=40)
    assert np.all(np.isnan(moved.pareto_k))
    assert moved.pointwise == pytest.approx(weighted.pointwise, abs=4.0)
    assert moved.elpd < float(np.max(posterior.problem.log_likelihood(posterior.flat_z(500))))


@pytest.fixture(scope="module")
def comparison(posterior, few_quick_walkers):
    return compare_families(
        posterior.problem.loops, ["constant_normal_force", "gamma1"], config=TINY, seed=2, by="tests", progress=False
    )


def test_the_family_that_made_the_loops_wins(comparison):
    assert [e.family.name for e in comparison.entries] == ["gamma1", "constant_normal_force"]
    first, second = comparison.rows()
    assert first.difference == 0 and second.difference < -20
    assert first.residual_share < 0.02 < second.residual_share
    assert first.parameters == 13


def test_page_and_table_of_a_comparison(comparison, tmp_path):
    text = comparison_report(comparison, tmp_path).read_text(encoding="utf-8")
    assert "one-gamma slip forces" in text and "<table" in text
    with (tmp_path / "compare.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [r["family"] for r in rows] == ["gamma1", "constant_normal_force"] and float(rows[1]["difference"]) < 0
    assert len(ranking_figure(comparison).axes) == 2


@pytest.mark.parametrize(("by", "k", "converged"), [("loo", 0.9, True), ("tests", 0.9, False), ("loo", 0.1, True)])
def test_terminal_and_page_say_what_is_not_to_be_trusted(comparison, tmp_path, monkeypatch, capsys, by, k, converged):
    def as_if(entry):
        loo = replace(entry.loo, pareto_k=np.full_like(entry.loo.pareto_k, k))
        return replace(entry, loo=loo, posterior=replace(entry.posterior, converged=converged))

    found = replace(comparison, by=by, entries=tuple(map(as_if, comparison.entries)))
    monkeypatch.setattr("bayes_iwan.compare", lambda *args, **options: found)
    assert main(["compare", str(tmp_path), "--out", str(tmp_path)]) == (0 if converged else 3)
    page = comparison_report(found, tmp_path).read_text(encoding="utf-8")
    for text in (capsys.readouterr().out, repr(found), page):
        said = " ".join(text.split())
        assert ("The Pareto k of 2 families are too high" in said) == (by == "loo" and k > 0.7)
        assert ("Not converged, so that their density is some nats off: one-gamma" in said) == (not converged)


def test_bad_requests_are_refused(posterior):
    with pytest.raises(CompareError, match=r"no family 'gama1'; did you mean 'gamma1'"):
        compare_families(posterior.problem.loops, ["gama1", "gamma2"])
    with pytest.raises(CompareError, match="at least two"):
        compare_families(posterior.problem.loops, ["gamma1"])
    with pytest.raises(CompareError, match="is not known; there are auto, loo, tests"):
        compare_families(posterior.problem.loops, ["gamma1", "gamma2"], by="eye")


def test_replicates_are_as_wide_as_measured_loops_wander(posterior):
    """Half of the measured points lie within the 50 % band, nine in ten within 90 %: mean forces included, which the
    likelihood lets err ten times further than these tests do."""
    used = np.stack([np.isfinite(x.noise_N) for x in posterior.problem.loops])  # data

    def in_band(force_N):
        spectrum = np.fft.rfft(force_N)
        spectrum[..., : used.shape[1]] *= used
        spectrum[..., used.shape[1] :] = 0.0
        return np.fft.irfft(spectrum)

    again = in_band(posterior.forces(600, replicate=True))
    measured = in_band(posterior.problem.measured_N)
    for level, least, most in ((0.5, 0.35, 0.7), (0.9, 0.81, 0.995)):  # of some 100 numbers that were fitted
        low, high = np.quantile(again, [0.5 - level / 2, 0.5 + level / 2], axis=0)
        assert least < np.mean((measured >= low) & (measured <= high)) < most
    free = posterior.problem.likelihood.mean_error_N
    assert np.all(again.mean(axis=-1).std(axis=0) < 0.3 * free)


def test_loo_pit_of_independent_errors_has_no_more_data_than_the_loops():
    """The bands of its figure are of so many independent ones: of every sample they would be too narrow."""
    settings = replace(SETTINGS, likelihood=LikelihoodSettings("gaussian"))
    alone = made_posterior(made_records(TESTS[2:4]), settings)
    known = sum(2 * int(np.isfinite(x.noise_N).sum()) - 1 for x in alone.problem.loops)
    assert known < 0.6 * alone.problem.measured_N.size
    assert loo_pit(alone).shape == (known,)


def test_loo_pit_is_uniform_and_without_means(posterior):
    pit = loo_pit(posterior)
    harmonics = sum(int(np.isfinite(x.noise_N).sum()) - 1 for x in posterior.problem.loops)
    assert pit.shape == (2 * harmonics,)
    assert stats.kstest(pit, "uniform").pvalue > 0.01
