"""A paragraph of methods for a paper, made from what was really run."""

from __future__ import annotations

from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.models import Model
from bayes_iwan.report.cite import SOFTWARE

_LIKELIHOOD = {
    "correlated": "a Gaussian likelihood of the loops' harmonics, with the measured noise and a smooth discrepancy "
    "whose size is inferred",
    "unweighted": "a Gaussian likelihood of the loops' harmonics, all alike, with a smooth discrepancy",
    "matern": "a Gaussian likelihood of the loops' harmonics with a Matérn discrepancy whose size and length are "
    "inferred",
    "gaussian": "a Gaussian likelihood of independent samples",
    "laplace": "a Laplace likelihood of independent samples",
}


def methods(posterior: Posterior) -> str:
    """What was done, in the past tense: data, model, likelihood, priors, search, sampling, software."""
    problem, settings, timings = posterior.problem, posterior.settings, posterior.timings
    loops = problem.loops
    f, a = sorted({x.record.frequency_hz for x in loops}), sorted({x.record.amplitude_mm for x in loops})
    cycles, clock = sorted(x.n_cycles for x in loops), loops[0].record.clock
    model, speeds = problem.model, f"{_span(f, 'Hz')} and " if clock else ""
    parts = []
    if isinstance(model, Model):
        parts.append(
            f"The generalized Iwan model ({model.slip} slip forces, {model.normal_force} normal force, "
            f"{model.stiffness} "
            "stiffness) was identified from"
        )
    else:
        parts.append(f"The model {model.name} was identified from")
    parts[0] += (
        f" {len(loops)} harmonic test{'s' if len(loops) != 1 else ''} at {speeds}amplitudes of "
        f"{_span(a, 'mm')}, each averaged in phase over {_span([float(c) for c in cycles], 'cycles')} into "
        f"{loops[0].phase.size} points."
    )
    free = len(problem.prior.free)
    fixed = len(problem.prior.parameters) - free
    parts.append(
        f"The {free} free parameters{f' ({fixed} more were fixed or tied)' if fixed else ''} had the priors of the "
        f"table of priors, with {_LIKELIHOOD.get(problem.likelihood.name, problem.likelihood.name)}."
    )
    search = settings.search
    if posterior.quick:
        parts.append(
            "The most probable point was found by least squares from several starts; intervals are from a normal "
            "approximation about it, and nothing was sampled."
        )
    else:
        count = len(posterior.point.each_log_prob)
        parts.append(
            f"The most probable point was sought by a genetic algorithm with {search.members} members, followed by "
            f"least squares, in {count} independent search{'es' if count != 1 else ''}."
        )
        chains = posterior.z.shape[0]
        way = f"{chains} independent ensembles of {posterior.walkers} walkers"
        rows = posterior.convergence
        reached = ""
        if rows:
            reached = (
                f" (largest R-hat {max(r.r_hat for r in rows):.3f}, smallest bulk effective sample size "
                f"{min(r.ess_bulk for r in rows):.0f})"
            )
        parts.append(
            f"The posterior was sampled by emcee, {way} and {timings.get('steps', 0.0):.0f} steps; "
            f"{'convergence was reached' if posterior.converged else 'it had not converged'}{reached}, and "
            f"{posterior.z.shape[0] * posterior.z.shape[1]} draws were kept."
        )
    if posterior.stretch > 1.0:
        parts.append(
            "The optimum was found again without each test in turn. Draws were made wider where these optima differ by "
            f"more than the posterior says (by up to a factor of {posterior.stretch:.2g})."
        )
    shown = ", ".join(f"{k} {v}" for k, v in posterior.versions.items() if k != "bayes_iwan")
    parts.append(f"Seed {posterior.seed}; {SOFTWARE}, with {shown}.")
    return " ".join(parts)


def _span(values: list[float], unit: str) -> str:
    low, high = f"{min(values):g}", f"{max(values):g}"
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
