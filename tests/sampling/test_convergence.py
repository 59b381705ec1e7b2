"""The diagnostics against ArviZ, against repeated runs, and on ensembles that have and have not converged."""

import warnings

import numpy as np
import pytest
from scipy.signal import lfilter

from bayes_iwan.sampling.convergence import Convergence, autocorrelation_time, convergence_of, ess_tail, r_hat_and_ess

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # 0.23 announces 1.0 at import
    import arviz as az


def autoregressive(phi, shape, rng):
    """Stationary AR(1) series of unit variance along the second axis."""
    noise = rng.standard_normal(shape) * np.sqrt(1 - phi**2)
    noise[:, 0] /= np.sqrt(1 - phi**2)
    return lfilter([1], [1, -phi], noise, axis=1)


@pytest.mark.parametrize("phi", [0.0, 0.6, 0.95, -0.4])
def test_one_walker_an_ensemble_is_arvizs_number(phi):
    x = autoregressive(phi, (4, 1000, 1), np.random.default_rng(0))
    one = x[..., 0]
    assert r_hat_and_ess(x)[0] == pytest.approx(float(np.asarray(az.rhat(one))), abs=1e-6)
    assert r_hat_and_ess(x)[1] == pytest.approx(float(np.asarray(az.ess(one, method="bulk"))), rel=0.01)
    tail = float(np.asarray(az.ess(one, method="tail", prob=(0.05, 0.95))))
    assert ess_tail(x) == pytest.approx(tail, rel=0.02)


def test_walkers_are_arvizs_chains_and_r_hat_compares_ensembles():
    x = autoregressive(0.9, (4, 400, 16), np.random.default_rng(7))
    chains = np.moveaxis(x, 2, 1).reshape(64, 400)
    found = convergence_of(x[..., None], ("x",), thin=3)
    assert (found.r_hat[0], found.ess_bulk[0]) == r_hat_and_ess(x) and found.ess_tail[0] == ess_tail(x)
    assert found.ess_bulk[0] == pytest.approx(float(np.asarray(az.ess(chains, method="bulk"))), rel=0.01)
    tail = float(np.asarray(az.ess(chains, method="tail", prob=(0.05, 0.95))))
    assert found.ess_tail[0] == pytest.approx(tail, rel=0.02)
    together = x.reshape(4, 400 * 16)  # each half of an ensemble's run, all its walkers, is one of its chains
    assert found.r_hat[0] == pytest.approx(float(np.asarray(az.rhat(together))), abs=1e-6)
    assert found.r_hat[0] < 1.01 < float(np.asarray(az.rhat(chains)))
    assert found.tau_steps[0] == pytest.approx(3 * 19.0, rel=0.15)


def test_sizes_are_the_variance_of_the_mean_over_repeated_runs():
    rng, means, sizes = np.random.default_rng(8), [], []
    for _ in range(100):
        x = autoregressive(0.9, (4, 400, 16), rng)
        means.append(x.mean())
        sizes.append(r_hat_and_ess(x)[1])
    assert np.median(sizes) == pytest.approx(1.0 / np.var(means), rel=0.3)
    assert np.median(sizes) == pytest.approx(4 * 400 * 16 / 19.0, rel=0.1)


def test_a_walker_that_stands_still_is_seen():
    x = autoregressive(0.5, (4, 400, 16), np.random.default_rng(9))
    moving = convergence_of(x[..., None], ("x",))
    x[:, :, 0] = 2.5
    stuck = convergence_of(x[..., None], ("x",))
    assert stuck.ess_bulk[0] < 0.1 * moving.ess_bulk[0] and stuck.tau_steps[0] > 10 * moving.tau_steps[0]


def test_autocorrelation_time_is_that_of_the_process():
    x = autoregressive(0.9, (4, 3000, 16), np.random.default_rng(2))
    assert autocorrelation_time(x) == pytest.approx(19.0, rel=0.1)


def test_a_walker_that_stands_still_lengthens_the_autocorrelation_time():
    x = autoregressive(0.5, (4, 1000, 16), np.random.default_rng(3))
    moving = autocorrelation_time(x)
    x[0, :, 0] = 3.0
    assert autocorrelation_time(x) > 5 * moving


def test_one_ensemble_in_another_mode_is_flagged_though_its_walkers_agree():
    rng = np.random.default_rng(4)
    good = autoregressive(0.7, (4, 800, 16), rng)
    stuck = good.copy()
    stuck[2] += 2.0
    result = convergence_of(np.stack([good, stuck], axis=3), ("good", "stuck"), thin=2)
    assert result.r_hat[0] < 1.01 < 1.1 < result.r_hat[1]
    assert result.ess_bulk[0] > 1000 and result.ess_bulk[1] < 0.02 * result.ess_bulk[0]
    assert result.n_steps == 1600 and result.tau_steps[0] == pytest.approx(2 * 1.7 / 0.3, rel=0.15)
    assert "R-hat of stuck" in result.shortfall(1.01, 400, 50) and "good" not in result.shortfall(1.01, 400, 50)


def test_another_width_is_flagged_though_the_means_agree():
    rng = np.random.default_rng(5)
    x = autoregressive(0.3, (4, 800, 16), rng)
    x[1] *= 2.0
    assert r_hat_and_ess(x)[0] > 1.05


def test_a_drift_within_the_run_is_flagged():
    x = autoregressive(0.3, (4, 800, 16), np.random.default_rng(6)) + np.linspace(0, 1.5, 800)[None, :, None]
    assert r_hat_and_ess(x)[0] > 1.05


def test_numbers_that_say_nothing_are_nan_and_do_not_pass():
    same = np.zeros((4, 100, 8, 1))
    result = convergence_of(same, ("x",))
    assert np.isnan(result.r_hat[0]) and np.isnan(result.ess_bulk[0])
    assert result.shortfall(1.01, 400, 50) != ""
    with pytest.raises(ValueError, match="draws of shape"):
        convergence_of(same, ("x", "y"))


def test_what_is_judged_by_r_hat_alone_needs_no_effective_draws():
    """A slow walk and independent draws: the former is short of effective draws and of steps, and not named."""
    rng = np.random.default_rng(3)
    good = rng.standard_normal((4, 400, 8))
    slow = np.cumsum(rng.standard_normal((4, 400, 8)), axis=1)
    draws = np.stack([good, slow], axis=3)
    whole, some = (convergence_of(draws, ("good", "slow"), by_r_hat=frozenset(x)) for x in ((), ("slow",)))
    assert "ESS of slow" in whole.shortfall(10.0, 400.0, 10.0) and some.shortfall(10.0, 400.0, 10.0) == ""
    assert some.least_ess > 400.0 > whole.least_ess and some.worst_tau < 3.0 < whole.worst_tau
    assert "R-hat of slow" in some.shortfall(1.01, 400.0, 10.0)


def test_what_falls_short_by_little_does_not_read_as_the_target():
    """ "150 steps are 10 autocorrelation times of slope < 10" says nothing."""
    one = {name: np.array([x]) for name, x in (("r_hat", 1.0102), ("ess_bulk", 399.7), ("ess_tail", 500.0))}
    said = Convergence(("slope",), **one, tau_steps=np.array([15.2]), n_steps=150).shortfall(1.01, 400.0, 10.0)
    assert "1.0102 > 1.01;" in said and "399.7 < 400;" in said and "9.868 autocorrelation times" in said
