"""Do the bands hold tests of a frequency that was not fitted? Each frequency held out in turn, and predicted.

The posterior of the other frequencies, by walkers that are led there from draws of the whole's, predicts the tests of
the one held out, with noise, and with the discrepancy as the likelihood carries it over from the others. What a long
run says of the same is in analyses/predict_untested.py. It is the one check of the bands that does not use the tests
which it checks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.campaign.timing.groups import groups_of
from bayes_iwan.inference.results.predictions import shown_noise
from bayes_iwan.inference.setup.marginal import Marginal
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.inference.setup.quantities import loop_quantities
from bayes_iwan.models.motion import motion_of
from bayes_iwan.sampling.run import draws_of_one_like_it
from bayes_iwan.screen import on_screen

#: share of a held-out frequency's points that 90 % bands must hold, or it is said that they do not hold there
HELD = 0.75
_KNOWN = 2000  # draws of the whole's posterior that are looked at, at most


@dataclass(frozen=True)
@on_screen
class HeldOutFrequency:
    """One frequency predicted from the others: what the central 50 and 90 % bands hold of its points, and what 90 %
    bands hold of its tests' energies and stiffnesses, as shares."""

    frequency_hz: float
    tests: tuple[str, ...]
    points_50: float
    points_90: float
    quantities_90: float

    @property
    def holds(self) -> bool:
        """Whether the 90 % bands hold about what they say."""
        return self.points_90 >= HELD


def by_frequency(loops: Sequence[Loop]) -> dict[str, tuple[Loop, ...]]:
    """Fitted loops grouped by frequency, by names such as f10Hz (of the lowest in it), lowest first; within a group in
    the campaign's order."""
    fitted = [x for x in loops if x.role != "held-out"]
    parts = groups_of([x.frequency_hz for x in fitted]) if fitted else []
    lowest = {min(fitted[i].frequency_hz for i in part): part for part in parts}
    return {f"f{low:.4g}Hz": tuple(fitted[i] for i in sorted(part)) for low, part in sorted(lowest.items())}


def held_out_frequencies(problem: Problem, draws: Array, seed: int = 0) -> tuple[HeldOutFrequency, ...]:
    """Each frequency of a problem's tests, lowest first, predicted from all others; none where there is one only.

    draws : of the whole's posterior (n, ndim).
    """
    groups = by_frequency(problem.loops)
    if len(groups) < 2:
        return ()
    known = draws[np.linspace(0, len(draws) - 1, min(len(draws), _KNOWN)).astype(int)]
    return tuple(_held_out(problem, known, loops, seed) for loops in groups.values())


def _held_out(problem: Problem, known: Array, left: Sequence[Loop], seed: int) -> HeldOutFrequency:
    files = {x.file for x in left}
    others = [t for t, x in enumerate(problem.loops) if x.file not in files]
    part = replace(
        problem, loops=tuple(problem.loops[t] for t in others), likelihood=problem.likelihood.of_tests(others)
    )
    z = draws_of_one_like_it(Marginal(part).density, known, (seed, 36))
    force, measured = predicted(part, z, left, seed)
    u = np.stack([x.displacement_mm for x in left])
    found, again = loop_quantities(u, measured), loop_quantities(u, force)
    inside = [_held(getattr(found, n), getattr(again, n), 0.9) for n in ("energy_mJ", "stiffness_N_mm")]
    return HeldOutFrequency(
        float(np.mean([x.frequency_hz for x in left])),
        tuple(x.file for x in left),
        _held(measured, force, 0.5),
        _held(measured, force, 0.9),
        float(np.mean(inside)),
    )


def _held(value: Array, draws: Array, level: float) -> float:
    low, high = np.quantile(draws, [0.5 - level / 2, 0.5 + level / 2], axis=0)
    return float(np.mean((value >= low) & (value <= high)))


def predicted(problem: Problem, z: Array, loops: Sequence[Loop], seed: int) -> tuple[Array, Array]:
    """Loops as measured again (draws, tests, samples), N, by draws z (draws, ndim) of a problem's posterior, and the
    measured ones (tests, samples), both less their means, which drift."""
    rng, fitted = np.random.default_rng([seed, 33]), len(problem.loops)
    force = problem.predict(z, motion_of((*problem.loops, *loops)))
    residual_N, force = problem.measured_N - force[:, :fitted], force[:, fitted:]
    noise = problem.likelihood.carried_over(residual_N, problem.parameter_values(z), loops, rng)
    force = force - force.mean(axis=-1, keepdims=True) + shown_noise(noise, loops)
    measured = np.stack([x.force_N for x in loops])
    return force, measured - measured.mean(axis=-1, keepdims=True)


def held_out_said(found: Sequence[HeldOutFrequency]) -> str:
    """What the bands of held-out frequencies hold, as a sentence; empty without any."""
    if not found:
        return ""
    shares = [x.points_90 for x in found]
    said = f"90 % bands of a frequency that is held out hold {100 * np.mean(shares):.0f} % of its points"
    if bad := [x for x in found if not x.holds]:
        where = ", ".join(f"at {x.frequency_hz:.3g} Hz only {100 * x.points_90:.0f} %" for x in bad)
        return f"{said} in the mean, {where}: do not trust predictions there, nor for conditions that were not tested."
    return f"{said} ({100 * min(shares):.0f} to {100 * max(shares):.0f} %, frequency by frequency)."
