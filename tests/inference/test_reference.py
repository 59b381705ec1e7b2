"""What follows from given parameters without chance, or with numbers of a seed, is what it was."""

import numpy as np
import pytest

from bayes_iwan.inference.results.floors import floors_at
from bayes_iwan.inference.results.held_out_frequencies import predicted
from bayes_iwan.inference.results.population import SpecimenDraws, population
from bayes_iwan.inference.results.predictions import replicated, residual_size
from bayes_iwan.inference.results.reach import reach_of
from bayes_iwan.inference.setup.likelihood import KINDS
from bayes_iwan.inference.setup.marginal import Marginal
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.setup.quantities import quantities
from bayes_iwan.inference.solving.jackknife import stretched
from bayes_iwan.inference.solving.point import most_probable
from bayes_iwan.sampling.blocks import generator


@pytest.fixture(scope="module")
def loops(kit):
    return kit.campaign_of(kit.rig_records(None)).loops(n_phase=64, n_harmonics=12)


@pytest.fixture(scope="module")
def problem(loops):
    return make_problem(loops)


@pytest.fixture(scope="module")
def z(problem):
    """Two places near the middle of the prior, and the optimum that is found from them."""
    near = 0.4 * np.sin(np.outer([1, 2], np.arange(1, problem.ndim + 1)))
    return np.concatenate([near, most_probable(problem, near)[0][:1]])


def test_the_optimum(problem, z, reference):
    values = problem.parameter_values(z[2:])
    reference({n: values[n] for n in ("kp_N_mm", "k1_N_mm", "noise_scale")} | {"log_prob": problem.log_prob(z[2:])})


@pytest.mark.parametrize("kind", KINDS)
def test_likelihoods(loops, reference, kind):
    problem = make_problem(loops, {"likelihood": {"kind": kind}})
    z = 0.4 * np.sin(np.outer([1, 2], np.arange(1, problem.ndim + 1)))
    again = replicated(problem, problem.predict(z), problem.parameter_values(z), np.random.default_rng(3))
    reference({
        "name": problem.likelihood.name,
        "log_likelihood": problem.log_likelihood(z),
        "log_prob": problem.log_prob(z),
        "pointwise": problem.pointwise(z).sum(axis=-1),
        "rows": np.sum(problem.rows(z) ** 2, axis=-1),
        "replicated": again.std(axis=-1),
    })  # fmt: skip


def test_quantities(problem, z, reference):
    found = quantities(problem, z)
    reference({name: q.values for name, q in found.items()} | {"units": [q.unit for q in found.values()]})


def test_what_is_integrated_out(problem, z, reference):
    density = Marginal(problem).density
    x = density.apart(z)
    found = density(x, generator((1,)))
    reference({"x": x, "found": found, "whole": density.whole(x, found[:, 1:])})


def test_predictions_of_other_tests(problem, loops, z, reference):
    z = z[2] + 0.02 * np.sin(np.outer(np.arange(1, 41), np.arange(1, problem.ndim + 1)))
    force, measured = predicted(problem, z, loops[:2], 0)
    size, reach, floors = residual_size(problem, z), reach_of(problem, z), floors_at(problem, z[0])
    reference({
        "force": force.std(axis=0)[:, ::8], "measured": measured[:, ::8],
        "size": size, "reach": reach, "floors": floors,
    })  # fmt: skip


def test_widths_that_the_tests_disagreement_asks_for(problem, z, reference):
    z = z[2] + 0.02 * np.sin(np.outer(np.arange(1, 161), np.arange(1, problem.ndim + 1)))
    wide, stretch = stretched(problem, z, 0)
    reference({"sd": wide.std(axis=0), "stretch": stretch})


@pytest.mark.parametrize("middles", [[1.0, 1.2, 1.1, 0.8, 4.0], [1.0] * 9 + [4.0] * 3, [1.0] * 10 + [5.0]])
def test_a_population(reference, middles):
    """One that fits, one that hardly does, one that does not."""
    at, prior = np.linspace(-2.0, 3.0, 81), np.exp(3.0 * np.linspace(-2.5, 2.5, 400))
    some = [SpecimenDraws(f"s{i}", np.exp(x + 0.1 * (1 + i % 3) * at), prior) for i, x in enumerate(middles)]
    found = population(some)
    numbers = ("relative", "typical", "spread", "next_specimen", "pit", "open_end", "centre", "error", "mean", "tau")
    reference({n: getattr(found, n) for n in numbers} | {"fits": found.fits(), "doubt": found.doubt})
