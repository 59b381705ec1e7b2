"""Simpler ways to name a cause, from the same data and refits as a diagnosis: what its answers are to be measured by.

Each gives an answer in the form that the first version's `diagnosis.json` had (exclusive labels), which the score reads
beside the present one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.effects.base import Effect
from bayes_iwan.gap.data import GapData, predicted
from bayes_iwan.gap.diagnosis import diagnose_folder, write_json
from bayes_iwan.gap.evidence import Fit, Rows, extended
from bayes_iwan.gap.search import Search

Answer = dict[str, Any]

#: correlation: a residual below this share of the friction force is called none, and a signature that matches a
#: residual with a cosine below the second is called unknown
LITTLE, MATCH = 0.01, 0.6
NAMES = ("uniform guess", "correlation", "BIC")


def answer_of(probabilities: Mapping[str, float], cause: str, second: str | None = None) -> Answer:
    """An answer that names no look-alikes."""
    total = sum(probabilities.values())
    return {
        "verdict": {"cause": cause, "second_cause": second, "cannot_tell_apart": [cause]},
        "probabilities": {n: float(p / total) for n, p in probabilities.items()},
    }


def uniform_guess(names: tuple[str, ...], rng: np.random.Generator) -> Answer:
    """Any of the names (with none and unknown) with the same probability, and one of them drawn."""
    labels = ("none", "unknown", *names)
    return answer_of(dict.fromkeys(labels, 1.0), str(rng.choice(labels)))


def correlation(data: GapData, base: Fit, effects: Mapping[str, tuple[Effect, ...]]) -> Answer:
    """The effect whose plain signature looks most like the plain residual: cosine in newtons, nothing refitted.

    signature : what the effect, at its typical strength and shapes, adds to the base model's prediction; for a signed
    effect either sign. What the base's own numbers could imitate is not taken out.
    """
    evolving = [n for n, some in effects.items() if some[0].evolving]
    residual = _newtons(data, base.problem, base.z[None])[0]
    # the mean force counts as any harmonic does; changes along the record are zero in every steady prediction
    cosine: dict[str, float] = {}
    for name, some in effects.items():
        best = 0.0
        for effect in some:
            problem = extended(base.problem, (effect,))
            z = np.zeros((2, problem.ndim))
            at = [problem.names.index(n) for n in base.problem.names]
            z[:, at] = base.z
            on = [problem.names.index(p.name) for p in effect.parameters if p.name in problem.names]
            single = effect.strength_name in problem.names
            z[1, on[:1]] = 0.625 if effect.signed else 0.0  # a signed prior is 1.6 times the typical strength
            z[0, on[:1] if single else on] = 0.0 if effect.signed else -8.0
            off, there = _newtons(data, problem, z)
            change = off - there  # both are measured less predicted
            size = np.linalg.norm(change) * np.linalg.norm(residual)
            if size > 0.0 and np.isfinite(size):
                value = float(np.vdot(change, residual).real / size)
                best = max(best, abs(value) if effect.signed or name in evolving else value)
        cosine[name] = best
    p = {n: c**2 for n, c in cosine.items()}
    leader = max(p, key=lambda n: p[n])
    rms = float(np.linalg.norm(residual[: data.tests * data.harmonics_N.shape[1]])) / np.sqrt(2.0 * data.tests)
    share = rms / float(np.sqrt(np.mean(data.level_N**2)))
    little = share < LITTLE
    poor = cosine[leader] < MATCH
    sum_p = sum(p.values()) or 1.0
    p["none"], p["unknown"] = (sum_p if little else 0.1 * sum_p), (sum_p if poor else 0.1 * sum_p)
    return answer_of(p, "none" if little else "unknown" if poor else leader)


def _newtons(data: GapData, problem, z: Array) -> Array:
    """Measured − predicted, (draws, m) complex in N: harmonics that were resolved, then contrasts between blocks."""
    mean, trend, lines = predicted(data, problem, z)
    seen = np.stack([np.isfinite(x.noise_N) for x in data.loops])
    first = np.where(seen, data.harmonics_N - mean, 0.0)
    second = np.where(np.isfinite(data.trend_noise_N), data.trend_N - (0.0 if trend is None else trend), 0.0)
    third = np.where(np.isfinite(data.mains_noise_N), data.mains_N - (0.0 if lines is None else lines), 0.0)
    third = np.broadcast_to(third, (len(z), *data.mains_N.shape))
    second = np.broadcast_to(second, (len(z), *data.trend_N.shape))
    return np.concatenate([x.reshape(len(z), -1) for x in (first, second, third)], axis=1)


def bic(found: Search) -> Answer:
    """Schwarz's criterion n ln(RSS/n) + k ln n over the same refits, as if all misfit were white noise.

    RSS in units of the measured noise over all n data, changes along the record included; weights exp(−BIC/2).
    There is no hypothesis "unknown".
    """
    n = _count(found.data)
    value: dict[tuple[str, ...], float] = {(): _bic(found.data, found.base, n)}
    for name, fits in found.singles.items():
        if fits:
            value[name,] = min(_bic(found.data, f, n) for f in fits)
    value |= {key: _bic(found.data, fit, n) for key, fit in found.pairs.items()}
    least = min(value.values())
    leader = min(value, key=lambda k: value[k])
    p = dict.fromkeys(("none", "unknown", *found.singles), 0.0)
    for key, v in value.items():
        p[key[0] if key else "none"] += float(np.exp(-0.5 * (v - least)))
    return answer_of(p, leader[0] if leader else "none", leader[1] if len(leader) == 2 else None)


def _count(data: GapData) -> int:
    seen = np.stack([np.isfinite(x.noise_N) for x in data.loops])
    return int(
        2 * seen.sum()
        - data.tests
        + 2 * np.isfinite(data.trend_noise_N).sum()
        + 2 * np.isfinite(data.mains_noise_N).sum()
    )


def _bic(data: GapData, fit: Fit, n: int) -> float:
    rss = float(fit.linear.residual @ fit.linear.residual) - 2.0 * Rows(data, fit.problem).constant
    return n * float(np.log(rss / n)) + len(fit.z) * float(np.log(n))


def baselines(found: Search, seed: int) -> dict[str, Answer]:
    """All baselines from the data, the base fit and the refits of one search."""
    effects = {name: tuple(replace(e) for e in some) for name, some in found.effects.items()}
    return {
        "uniform guess": uniform_guess(tuple(effects), np.random.default_rng([seed, 9])),
        "correlation": correlation(found.data, found.base, effects),
        "BIC": bic(found),
    }


def diagnose_with_baselines(campaign: Path, out: Path, seed: int, quick: bool) -> Answer:
    """Diagnose as :func:`bayes_iwan.gap.diagnosis.diagnose` does, and write `baselines.json` beside the answer."""
    result, fits = diagnose_folder(campaign, seed=seed, quick=quick)
    write_json(Path(out) / "baselines.json", baselines(result.found, seed))
    write_json(Path(out) / "fits.json", fits)
    answer = result.as_dict()
    write_json(Path(out) / "diagnosis.json", answer)
    return answer
