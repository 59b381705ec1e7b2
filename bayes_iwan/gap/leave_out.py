"""How far the gap shrinks on tests that a fit has not seen: held-out ones, or one frequency after another left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_iwan.campaign import Loop
from bayes_iwan.effects.base import effects_of
from bayes_iwan.gap.data import GapData, gap_data
from bayes_iwan.gap.evidence import Fit, fit_model
from bayes_iwan.gap.gap_size import GapSize, gap_size
from bayes_iwan.gap.residuals import residual_of
from bayes_iwan.inference.problem import Problem


@dataclass(frozen=True)
class Unseen:
    """Gap of two models on tests that neither was fitted to.

    by : "held-out tests", "one frequency left out", "one amplitude left out"; tests : files of these tests
    before_N, after_N : RMS over those tests, N; shrink : 1 − after / before; low, high : its 90 % interval
    """

    by: str
    tests: tuple[str, ...]
    before_N: float
    after_N: float
    shrink: float
    low: float
    high: float


def groups_of(loops: Sequence[Loop]) -> tuple[str, list[list[int]]]:
    """Tests grouped by frequency, or by amplitude where there is only one frequency."""
    for name, by in (("frequency_hz", "one frequency left out"), ("amplitude_mm", "one amplitude left out")):
        key = np.round(np.log([getattr(x, name) for x in loops]) / 0.05).astype(int)
        parts = [np.flatnonzero(key == k).tolist() for k in np.unique(key)]
        if len(parts) > 1:
            return by, parts
    return "", []


def for_loops(problem: Problem, loops: Sequence[Loop], data: GapData) -> Problem:
    """The same model and priors for other tests (a hum's numbers go with its tests)."""
    files = tuple(x.file for x in loops)
    effects = tuple(replace(e, tests=files) for e in effects_of(problem))
    return replace(problem, loops=tuple(loops), likelihood=data.likelihood).with_effects(effects)


def refitted(fit: Fit, data: GapData) -> Fit:
    """A fit's model refitted to other tests, from its own optima."""
    problem = for_loops(fit.problem, data.loops, data)
    starts = np.concatenate([fit.z[None], fit.optima[1:2]])
    at = [fit.problem.names.index(n) for n in problem.names]
    return fit_model(data, problem, starts[:, at], iterations=20)


def unseen_gap(
    base: Fit, fits: dict[str, Fit], data: GapData, held_out: Sequence[Loop], seed: int
) -> dict[str, Unseen]:
    """Gap before (base) and after (each of fits), on held-out tests if there are any, else by leaving out."""
    if held_out:
        other = gap_data(held_out)
        before = gap_size(residual_of(other, base), seed)
        after = {n: gap_size(residual_of(other, f), seed, friction_N=before.friction_N) for n, f in fits.items()}
        return {n: _summary("held-out tests", [(before, a)]) for n, a in after.items()}
    by, parts = groups_of(data.loops)
    found: dict[str, list[tuple[GapSize, GapSize]]] = {n: [] for n in fits}
    for part in parts:
        rest, left = data.part([i for i in range(data.tests) if i not in part]), data.part(part)
        before = gap_size(residual_of(left, refitted(base, rest)), seed)
        for name, fit in fits.items():
            left_after = gap_size(residual_of(left, refitted(fit, rest)), seed, friction_N=before.friction_N)
            found[name].append((before, left_after))
    return {n: _summary(by, pairs) for n, pairs in found.items() if pairs}


def _summary(by: str, pairs: list[tuple[GapSize, GapSize]]) -> Unseen:
    before = np.array([t.rms_N**2 for b, _ in pairs for t in b.tests])
    after = np.array([t.rms_N**2 for _, a in pairs for t in a.tests])
    b, a = float(np.sqrt(before.mean())), float(np.sqrt(after.mean()))
    whole = 1.0 - a / b if b > 0 else float("nan")
    draws_b = np.concatenate([g.plausible for g, _ in pairs], axis=1).mean(axis=1)
    draws_a = np.concatenate([g.plausible for _, g in pairs], axis=1).mean(axis=1)
    draws = 1.0 - np.sqrt(draws_a / np.maximum(draws_b, 1e-3 * max(before.mean(), 1e-300)))
    low, high = np.quantile(draws, [0.05, 0.95])
    files = tuple(f for g, _ in pairs for f in g.files)
    return Unseen(by, files, b, a, whole, float(min(low, whole)), float(max(high, whole)))
