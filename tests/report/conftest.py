"""A small posterior that needs no sampler: loops of a known model with noise, Gaussian draws at the optimum."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayes_iwan.campaign import Campaign, Record, average
from bayes_iwan.inference.results.posterior import ConvergenceRow, Posterior
from bayes_iwan.inference.setup.config import settings_of
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.solving import posterior_draws
from bayes_iwan.inference.solving.point import Point, laplace_scale, most_probable
from bayes_iwan.models import Model, Reference, sine_motion
from bayes_iwan.report import style
from bayes_iwan.sampling.convergence import convergence_of

from .chromium import BROWSER, NO_BROWSER, PIPES, Chromium

RATE = 1280.0
TRUTH = {"kp_N_mm": 5.4, "force_zero_N": 0.0, "k1_N_mm": 15.0, "stiffness_ratio": 0.6, "t1_N": 0.5, "eta1": 2.2}
TRUTH |= {"g1": 1.0, "normal_force_slope": 0.3, "normal_force_rate": 0.07, "beta": 0.6}
SETTINGS = settings_of({"model": {"slip": "gamma1", "embedded": False}})


def made_records(tests, truth=TRUTH, noise_N=0.01, cycles=16, change=None):
    """Records of the model's loops, (frequency, amplitude, role) each; `change(numbers, f)` may alter the truth."""
    rng = np.random.default_rng(5)
    model = Model(Reference(1.0, 0.13), slip="gamma1")
    records = []
    for f, a, role in tests:
        parameter_values = {k: np.array([v]) for k, v in (change(dict(truth), f) if change else truth).items()}
        motion = sine_motion(frequency_hz=f, amplitude_mm=a, samples=512)
        force = model.force(parameter_values, motion)[0, 0]
        t = np.arange(int(cycles * RATE / f)) / RATE
        phase = (f * t) % 1.0
        grid = np.arange(513) / 512
        u = a * np.sin(2 * np.pi * phase) + 1e-5 * rng.standard_normal(t.size)
        measured = np.interp(phase, grid, np.r_[force, force[0]]) + noise_N * rng.standard_normal(t.size)
        records.append(Record(f"f{f:g}_a{a:g}.csv", f, a, role, {}, t, u, measured))
    return tuple(records)


def made_posterior(records, settings=SETTINGS, draws=1024, path=Path(".")):
    """A posterior of Gaussian draws at the optimum, as if of four ensembles with eight walkers."""
    campaign = Campaign("made loops", "sines through a known model", "", "", path, records)
    loops = tuple(average(r) for r in records)
    problem = make_problem(loops, settings)
    rng = np.random.default_rng(1)
    starts = problem.prior.draw(rng, 200)
    starts[:, -3:] = 0.0
    starts = starts[np.argsort(problem.goal(starts))[:6]]
    optima, log_prob, _ = most_probable(problem, starts)
    scale = laplace_scale(problem, optima[0])
    z = np.clip(optima[0] + rng.standard_normal((draws, problem.ndim)) @ scale.T, -7.9, 7.9)
    lp = problem.log_prob(z)
    z, lp = z[np.isfinite(lp)], lp[np.isfinite(lp)]
    keep = len(z) // 32 * 32
    z, lp = z[:keep].reshape(4, -1, problem.ndim), lp[:keep].reshape(4, -1)
    c = convergence_of(np.moveaxis(z.reshape(4, 8, -1, problem.ndim), 1, 2), problem.names)
    rows = tuple(ConvergenceRow(*x) for x in zip(c.names, c.ess_bulk, c.ess_tail, c.r_hat, c.tau_steps))
    best, found = (optima[0], float(problem.goal(optima[:1])[0])), (optima[:1], log_prob[:1])
    point = Point(*best, 0.01, optima[0], float(log_prob[0]), 0.0, optima, log_prob, (), 1, 0.1, *found)
    said = {"seed": 1, "converged": True, "message": "made for tests", "versions": {"python": "3"}}
    said["timings"] = {"point_s": 1.0, "sampling_s": 2.0, "steps": 100.0, "evaluations": 1e4}
    return Posterior(problem, campaign, loops, z, lp, 8, 1, point, settings=settings, convergence=rows, **said)


TESTS = ((10.0, 0.4, "fit"), (10.0, 1.0, "fit"), (20.0, 0.4, "fit"), (20.0, 1.0, "fit"), (15.0, 0.7, "held-out"))


@pytest.fixture(scope="session")
def posterior():
    return made_posterior(made_records(TESTS))


@pytest.fixture(scope="session")
def wandering():
    """Loops whose parallel spring changes with frequency, which the model cannot follow."""

    def change(parameter_values, f):
        return {**parameter_values, "kp_N_mm": parameter_values["kp_N_mm"] * (1.04 if f > 15 else 1.0)}

    return made_posterior(made_records(TESTS[:4], change=change))


@pytest.fixture(scope="session")
def page(posterior, once):
    """The folder of a report, with report.html and report.pdf in it."""
    from bayes_iwan.report.identification.identification_page import identification_report

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayes_iwan.report.page.FILES", False)  # of its figures, which have tests of their own
        patch.setattr("bayes_iwan.sampling.run.POPULATION", 64)  # in runs without a frequency
        patch.setitem(posterior_draws.QUICK, "walkers", 16)
        return once("report", lambda out: identification_report(posterior, out, pdf=BROWSER is not None))


@pytest.fixture(scope="module")
def no_phones():
    """Pages without their figures' variants for phones, which have the same texts."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "_on_phone", lambda drawn: style.blank(1.0))
        yield


@pytest.fixture(scope="session")
def chromium(tmp_path_factory):
    """One browser for all pages."""
    if BROWSER is None or not PIPES:
        pytest.skip(NO_BROWSER if PIPES else "Chromium is asked by POSIX pipes here")
    browser = Chromium(tmp_path_factory.mktemp("chromium"))
    yield browser
    browser.close()
