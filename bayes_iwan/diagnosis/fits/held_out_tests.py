"""Models refitted without some of the tests, and what they then miss on those: whole frequencies or amplitudes held
out, or tests that were held out from the start."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.campaign.timing.groups import groups_of
from bayes_iwan.diagnosis.fits.data import GapData, gap_data
from bayes_iwan.diagnosis.fits.evidence import Fit, beside
from bayes_iwan.diagnosis.fits.gap_size import gap_power_N2
from bayes_iwan.diagnosis.fits.residuals import residual_of
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.screen import on_screen
from bayes_iwan.threads import alongside

#: iterations of a refit that starts at the optimum of all tests
ITERATIONS = 8
HELD_OUT = "held-out tests"
_BY = {"frequency": "frequency_hz", "amplitude": "amplitude_mm"}


@dataclass(frozen=True)
@on_screen
class HeldOut:
    """Squared gaps on tests that a fit has not seen.

    by : "one frequency held out", "one amplitude held out" or "held-out tests"; files (n,) of these tests
    power_N2 : by set of effects, (n,) squared gap of each test, noise taken off (may be negative)
    trained : by set of effects, (3, n) of the tests that each was predicted from: ln evidence of the set, its squared
        gap and how many tests they were; nothing for tests that were held out from the start
    """

    by: str
    files: tuple[str, ...]
    power_N2: dict[frozenset[str], Array]
    trained: dict[frozenset[str], Array] = field(default_factory=dict)


def share_by_test(before_N2: Array, after_N2: Array) -> Array:
    """(n,) 1 − gap after / gap before, from squared gaps (n,), each in −1 … 1, so that one test with a large gap of
    another cause does not decide."""
    before, after = (np.sqrt(np.maximum(x, 0.0)) for x in (before_N2, after_N2))
    top = np.maximum(before, after)
    return np.asarray(np.where(top > 0.0, (before - after) / np.maximum(top, 1e-300), 0.0))


def for_loops(problem: Problem, loops: Sequence[Loop], data: GapData) -> Problem:
    """The same model and priors for other tests (parameters of mains interference go with its tests)."""
    files = tuple(x.file for x in loops)
    effects = tuple(replace(e, tests=files) for e in problem.effects)
    return replace(problem, loops=tuple(loops), likelihood=data.likelihood).with_effects(effects)


def refitted(fit: Fit, data: GapData) -> Fit:
    """A fit's model refitted to some of its tests from its own optimum, beside a discrepancy of the same size."""
    problem = for_loops(fit.problem, data.loops, data)
    at = [fit.problem.names.index(n) for n in problem.names]
    return beside(data, replace(fit, problem=problem), fit.size, [fit.z[at]], ITERATIONS)


def held_out_gaps(fits: Sequence[Fit], data: GapData, extra: Sequence[Loop] = ()) -> tuple[HeldOut, ...]:
    """Gaps of several models on held-out tests of their fit: one frequency after another, then one amplitude after
    another, where there are several; and on tests with role "held-out"."""
    out = []
    if extra:
        other = gap_data(extra)
        out.append(HeldOut(HELD_OUT, tuple(x.file for x in extra), {f.names: _held_out_N2(f, other) for f in fits}))
    for by, parts in parted(data).items():
        both = [(data.part([i for i in range(data.tests) if i not in part]), data.part(part)) for part in parts]
        pieces = [(fit, others, left) for others, left in both for fit in fits]
        power_N2: dict[frozenset[str], list[Array]] = {f.names: [] for f in fits}
        trained: dict[frozenset[str], list[Array]] = {f.names: [] for f in fits}
        for (fit, _, _), (gap_N2, fitted) in zip(pieces, alongside(_refit_gaps, pieces)):
            power_N2[fit.names].append(gap_N2)
            trained[fit.names].append(np.tile(fitted[:, None], len(gap_N2)))
        out.append(
            HeldOut(
                f"one {by} held out",
                tuple(data.loops[i].file for part in parts for i in part),
                {k: np.concatenate(x) for k, x in power_N2.items()},
                {k: np.concatenate(x, axis=1) for k, x in trained.items()},
            )
        )
    return tuple(out)


def parted(data: GapData) -> dict[str, list[list[int]]]:
    """The tests by frequency and by amplitude, where there are several."""
    out = {by: groups_of([getattr(x, name) for x in data.loops]) for by, name in _BY.items()}
    return {by: parts for by, parts in out.items() if len(parts) > 1}


def _refit_gaps(piece: tuple[Fit, GapData, GapData]) -> tuple[Array, Array]:
    """A fit's model refitted to the other tests: (n,) squared gaps on those held out; (3,) ln evidence, squared gap and
    number of the tests that it was fitted to."""
    fit, others, left = piece
    again = refitted(fit, others)
    size = again.size
    sizes = ((size.share, size.length, size.along),)
    nats = float(again.linear.evidence(sizes).log_z[0]) + others.layout(size.between, again.evolving).constant
    trained_N2 = max(float(gap_power_N2(residual_of(others, again)).mean()), 0.0)
    return _held_out_N2(again, left), np.array([nats, trained_N2, others.tests])


def _held_out_N2(fit: Fit, data: GapData) -> Array:
    """(n,) squared gaps on tests that it was not fitted to."""
    return gap_power_N2(residual_of(data, fit, refitted=False))
