"""Each frequency alone beside all together: do the parameters that should be constant wander with frequency?

Parameters that wander are the first sign of a missing effect. Whether they wander by more than errors allow is asked
of the joint posterior itself: loops are drawn from it, refitted frequency by frequency, and the spread of each
quantity among the frequencies is compared with the spread that the measured loops give (a posterior predictive check).
Refits are one Gauss–Newton step from the joint optimum, for drawn and measured loops alike.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from bayes_iwan.arrays import Array, ParameterValues
from bayes_iwan.campaign import Loop
from bayes_iwan.inference.identify import identify_problem
from bayes_iwan.inference.results.held_out_frequencies import by_frequency
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.results.remarks import at_a_bound
from bayes_iwan.inference.results.run_files import ResultsError, load
from bayes_iwan.inference.setup.likelihood import Likelihood
from bayes_iwan.inference.setup.priors import Z_LIMIT
from bayes_iwan.inference.setup.problem import Problem, make_problem
from bayes_iwan.inference.setup.quantities import quantities
from bayes_iwan.inference.setup.settings import IdentifySettings, SamplingSettings, SearchSettings

#: settings of the short runs for one frequency alone; results of `identify(..., per_test=True)` come first
SHORT = IdentifySettings(
    search=SearchSettings(members=60, evaluations=1500, second_search=False, starts=8),
    sampling=SamplingSettings(ensembles=2, walkers=64, budget_s=20.0, r_hat=1.05, ess=100.0, taus=15.0, draws=2048),
)
#: in a linear refit a step of z beyond this is cut: the linearisation means nothing there
_REACH = 4.0
#: contraction below which a quantity is not determined and says nothing about agreement
_DETERMINED = 0.5


@dataclass(frozen=True)
class Agreement:
    """One quantity, frequency by frequency.

    p_value : chance that frequencies would differ by more than measured if one set of values held for all.
    estimate, low, high : (frequencies,) each frequency alone, by one Gauss–Newton step from the joint optimum, and its
    90 % interval: quick, and right where the posterior is near Gaussian in z.
    """

    name: str
    unit: str
    p_value: float
    estimate: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class Frequencies:
    """The joint posterior, its frequencies, and the checks.

    groups : loops by frequency, lowest first. alone : posteriors of those frequencies that were identified alone.
    checks : one for each quantity that the loops determine; overall : of the worst of them, with the number of
    quantities looked at allowed for. None and NaN where there is one frequency only, or no such quantity.
    """

    joint: Posterior
    groups: Mapping[str, tuple[Loop, ...]]
    alone: Mapping[str, Posterior]
    checks: tuple[Agreement, ...]
    overall: float

    @property
    def hz(self) -> Array:
        """Mean frequency of each group."""
        return np.array([np.mean([x.frequency_hz for x in loops]) for loops in self.groups.values()])

    @property
    def agree(self) -> bool:
        """Whether differences between them are such as the joint model expects."""
        return self.overall >= 0.05

    def statement(self) -> str:
        """What the checks say, in words."""
        if not self.checks:
            why = "all tests are of one frequency" if len(self.groups) < 2 else "the tests determine no parameter"
            return f"Whether parameters change with frequency cannot be seen: {why}."
        worst = min(self.checks, key=lambda c: c.p_value)
        if not self.agree:
            named = ", ".join(c.name for c in sorted(self.checks, key=lambda c: c.p_value) if c.p_value < 0.05)
            return (
                f"The frequencies do not agree (posterior check p = {p_text(self.overall)}): {named or worst.name} "
                "changes with frequency by more than the joint model allows. An effect is missing."
            )
        return (
            f"The frequencies agree: differences between them are such as the joint model expects (posterior check "
            f"p = {p_text(self.overall)}; the furthest apart is {worst.name}, p = {p_text(worst.p_value)})."
        )


def p_text(value: float) -> str:
    """A p-value as it is said."""
    return f"{value:.2f}" if value >= 0.01 else "< 0.01"


def compare_frequencies(
    joint: Posterior, folder: str | os.PathLike[str] | None = None, *, run: bool = False, replicates: int = 1000
) -> Frequencies:
    """Each frequency of a joint posterior's fitted tests alone, and the checks whether they agree.

    folder : results of `identify(..., per_test=True)`, taken where they are of these data, this model and these
    priors. run : identify the frequencies that are not there by short runs (:data:`SHORT`);
    otherwise these have estimates only.
    """
    groups = by_frequency(joint.problem.loops)
    alone: dict[str, Posterior] = {}
    for name, loops in groups.items():
        if len(groups) == 1:
            alone[name] = joint
        elif folder is not None and (stored := _stored(joint, Path(folder) / "per_test" / name, loops)) is not None:
            alone[name] = stored
        elif run:
            chosen = replace(joint.settings, search=SHORT.search, sampling=SHORT.sampling)
            alone[name] = identify_problem(
                _problem(joint, loops), 0, config=chosen, campaign=joint.campaign, loops=loops, progress=False
            )
    if len(groups) == 1:
        return Frequencies(joint, groups, alone, (), float("nan"))
    checks, overall = agreement(joint, groups, replicates)
    return Frequencies(joint, groups, alone, checks, overall)


def _stored(joint: Posterior, folder: Path, loops: Sequence[Loop]) -> Posterior | None:
    """What `folder` holds of these loops alone, unless it is left from another campaign, model or prior."""
    try:
        where = None if joint.campaign is None else joint.campaign.path
        found = load(folder, where, joint.problem.model if joint.simulator_file else None)
    except ResultsError:
        return None
    return found if found.problem.fingerprint() == _problem(joint, loops).fingerprint() else None


def _problem(joint: Posterior, loops: Sequence[Loop]) -> Problem:
    problem = joint.problem
    part = make_problem(loops, joint.settings, problem.model, problem.scales)
    return part.with_effects(problem.effects) if problem.effects else part


def agreement(
    joint: Posterior, groups: Mapping[str, Sequence[Loop]], replicates: int = 1000
) -> tuple[tuple[Agreement, ...], float]:
    """The posterior check: p-values by quantity, and of the worst one among all."""
    problem = joint.problem
    rng = np.random.default_rng([0, 51])
    best = joint.flat_z()[int(np.argmax(joint.log_prob))]
    if np.isfinite(joint.point.log_prob) and joint.point.log_prob > np.max(joint.log_prob):
        best = joint.point.z
    physical = np.array([i for i, name in enumerate(problem.names) if name not in problem.noise_names])
    z = joint.flat_z(replicates)
    at_best = problem.predict(best[None])[0]
    force = problem.predict(z)
    drawn = problem.likelihood.replicate(force, problem.parameter_values(z), rng) - at_best
    measured = (problem.measured_N - at_best)[None]

    names, units, gradient = _gradients(joint, best, physical)
    if not names:
        return (), float("nan")
    files = [x.file for x in problem.loops]
    steps, spread, ways = [], [], []
    for loops in groups.values():
        part = _problem(joint, loops)
        tests = [files.index(x.file) for x in loops]
        parameter_values, likelihood = part.parameter_values(best[None]), problem.likelihood.of_tests(tests)

        def rows(
            residual: Array,
            likelihood: Likelihood = likelihood,
            parameter_values: ParameterValues = parameter_values,
        ) -> Array:
            repeated = {k: np.repeat(v, len(residual)) for k, v in parameter_values.items()}
            return likelihood.rows(residual, repeated)

        eye = np.zeros((len(physical), problem.ndim))
        eye[np.arange(len(physical)), physical] = 1e-3
        slope = (part.predict(best + eye) - part.predict(best - eye)) / 2e-3
        jacobian = rows(slope)  # (physical, m): d(prediction) whitened
        information = jacobian @ jacobian.T + np.eye(len(physical))
        every = np.concatenate([measured, drawn])[:, tests]
        right = rows(every) @ jacobian.T - best[physical]
        steps.append(np.clip(np.linalg.solve(information, right.T).T, -_REACH, _REACH))
        way = np.linalg.solve(information, gradient.T).T  # along which each quantity is uncertain
        spread.append(np.einsum("qi,qi->q", way, gradient))
        ways.append(way / np.sqrt(spread[-1])[:, None])
    q = np.einsum("fdi,qi->fdq", np.array(steps), gradient)
    weight = 1.0 / np.array(spread)[:, None, :]
    mean = np.sum(weight * q, axis=0) / np.sum(weight, axis=0)
    t = np.sum(weight * (q - mean) ** 2, axis=0)  # (1 + replicates, quantities)
    # ranks among all, the measured one included: no p-value is ever zero
    p = 1.0 - (rankdata(t, method="min", axis=0) - 1.0) / len(t)
    worst = p.min(axis=1)
    overall = float(np.mean(worst <= worst[0]))
    moved = np.tile(best, (3, len(groups), len(names), 1))  # middle, one end and the other
    moved[..., physical] += np.array(steps)[:, 0, None]
    moved[1:, ..., physical] += 1.645 * np.multiply.outer([-1.0, 1.0], ways)
    found = quantities(problem, np.clip(moved, -Z_LIMIT, Z_LIMIT).reshape(-1, problem.ndim), problem.loops[:1])
    values = [found[n].values.reshape(3, len(groups), -1)[..., i] for i, n in enumerate(names)]
    return tuple(
        Agreement(n, u, float(p[0, i]), x[0], x.min(axis=0), x.max(axis=0))
        for i, (n, u, x) in enumerate(zip(names, units, values))
    ), overall


def determined_names(joint: Posterior) -> tuple[str, ...]:
    """Scalars of the joint posterior that loops determine: physical parameters and slip-force quantiles."""
    problem = joint.problem
    variance = dict(zip(problem.names, np.var(joint.flat_z(), axis=0)))
    bounded = at_a_bound(joint)
    # numbers of the slip forces' density trade off against each other; its mean and quantiles stand for them
    shapes = ("eta", "share_", "slip_")
    chosen = [
        p.name
        for p in problem.prior.free
        if p.name not in problem.noise_names
        and not p.name.startswith(shapes)
        and p.name != "force_zero_N"
        and 1.0 - variance[p.name] > _DETERMINED
        and p.name not in bounded
    ]
    chosen += [n for n in joint.quantities() if n.startswith("slip_force_q") and "25" <= n[12:14] <= "75"]
    return tuple(chosen)


def _gradients(joint: Posterior, z: Array, physical: NDArray[np.int64]) -> tuple[list[str], list[str], Array]:
    """Names and units of the determined quantities, and their gradients over physical z (quantities, physical)."""
    eye = np.zeros((len(physical), len(z)))
    eye[np.arange(len(physical)), physical] = 1e-3
    found = quantities(joint.problem, np.concatenate([z[None], z + eye, z - eye]), joint.problem.loops[:1])
    names = [n for n in determined_names(joint) if n in found]
    n = len(physical)
    values = np.array([found[name].values for name in names]).reshape(-1, 1 + 2 * n)
    gradient = (values[:, 1 : n + 1] - values[:, n + 1 :]) / 2e-3
    keep = np.flatnonzero(np.any(gradient != 0.0, axis=1) & np.all(np.isfinite(gradient), axis=1))
    return [names[i] for i in keep], [found[names[i]].unit for i in keep], gradient[keep]
