"""Ways to tell a cause from what absorbs a foreign one, each as a figure below which an effect is not named.

    python analyses/open_set.py figures FITS/*.pickle --out OPEN       (one JSON a campaign)
    python analyses/open_set.py score FITS/*.pickle --figures OPEN --out analyses/ablation_open_set.csv [--half even]

law_error: nats by which the effect, its force distorted by a smooth factor over tests and harmonics (a Gaussian
    process of sd LAW_ERROR), is better than no effect, beside the discrepancy that was inferred without it (Sargsyan,
    Huan & Najm, Int. J. Uncertain. Quantif. 9 (2019) 365).
distortion: nats that the distortion itself brings, their sign turned: a right law needs little of it.
decoys: how much better the effect fits what is left without it than decoys do: its force and those of the other effects
    of the set, with their tests exchanged and the harmonics' phases turned; ln of squared correlations, over
    the best of twenty (after knockoffs: Barber & Candès, Ann. Stat. 43 (2015) 2055).
The coarsened posterior (Miller & Dunson), which the package uses, is scored by `ablate_diagnosis.py` (COARSENED 1: not
coarsened). Here an effect is not named whose figure is low.
"""

from __future__ import annotations

import argparse
import json
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ablate_diagnosis import changed_by, patched, row, scored, seconds_of, write
from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.assessment.calibration import calibration
from bayes_iwan.diagnosis.assessment.indicators import Figures
from bayes_iwan.diagnosis.assessment.verdict import named_by, unlisted_probability
from bayes_iwan.diagnosis.fits.data import GapData
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.diagnosis.fits.residual_rows import Rows
from bayes_iwan.diagnosis.fits.residuals import Residual, residual_of
from bayes_iwan.diagnosis.search.search_result import MODEL_FORM, Search
from bayes_iwan.executors import Failure, finished
from bayes_iwan.files import finite, write_whole
from bayes_iwan.inference.setup.spectrum import between_tests
from bayes_iwan.threads import linear_algebra
from study_cases import HALVES, Case, read_cases

#: sd of the factor that distorts an effect's force, and how it is correlated between tests and over ln of the harmonic
LAW_ERROR, BETWEEN, OCTAVES = 0.3, (1.0, 1.0, 0.05), 0.7
#: harmonics with a factor of their own; the last stands for all above
HARMONICS = 4
SCRAMBLED, BEST_OF = 20, 20
#: values of each figure below which an effect is not named
TRIED = {"law_error": (0.0, 0.5, 1.0, 1.5), "distortion": (-1.5, -1.0, 0.0), "decoys": (0.0, 1.0, 2.0)}


def force_of(data: GapData, fit: Fit, name: str) -> np.ndarray:
    """(T, M) what an effect adds at a fit's optimum, in the numbers of a residual."""
    z = fit.z.copy()
    effect = next(e for e in fit.effects if e.name == name)
    for p in effect.strength_names:
        z[fit.problem.names.index(p)] = 0.0 if effect.signed or effect.strength_name not in fit.problem.names else -8.0
    off = residual_of(data, replace(fit, z=z))
    return np.asarray(off.value - residual_of(data, fit).value)


def log_z(rows: Array, jacobian: Array, z: Array) -> float:
    """ln evidence of a linear model, residual rows (m,) and Jacobian (m, n) in units of their sd, at z (n,)."""
    b, precision = jacobian.T @ rows - z, jacobian.T @ jacobian + np.eye(len(z))
    return 0.5 * float(b @ np.linalg.solve(precision, b) - rows @ rows - z @ z - np.linalg.slogdet(precision)[1])


def distortions(residual: Residual, force: np.ndarray) -> np.ndarray:
    """(k, T, M) the force with each of the smooth factors that distort it, one sd of it."""
    tests = np.linalg.cholesky(between_tests(residual.data.loops, BETWEEN))
    group = np.clip(residual.order, 1, HARMONICS) - 1
    apart = np.abs(np.subtract.outer(*2 * [np.log(np.arange(1, HARMONICS + 1))]))
    orders = np.linalg.cholesky(np.exp(-apart / OCTAVES))[group]  # (M, HARMONICS)
    factors = np.einsum("ti,mj->ijtm", tests, orders).reshape(-1, *force.shape)
    return np.asarray(LAW_ERROR * factors * force)


def models(case: Case) -> tuple[GapData, dict[frozenset[str], Fit]]:
    """The best set of a case and it without each effect."""
    search = case.found.search
    whole = frozenset(search.chosen)
    return search.data, {k: search.fits[k] for k in (whole, *(whole - {n} for n in whole))}


def figures(data: GapData, fits: Mapping[frozenset[str], Fit]) -> dict[str, dict[str, float]]:
    """The figures of every effect of the largest set."""
    whole, rng = max(fits, key=len), np.random.default_rng(0)
    fit = fits[whole]
    forces = [force_of(data, fit, n) for n in sorted(whole)]
    out = {}
    for name in sorted(whole):
        less = fits[whole - {name}]
        with_it = replace(fit, size=less.size)
        rows = Rows(data, fit.problem, less.size.between)
        linear, sd = rows.linear(fit.z), rows.sd(less.size)
        other = Rows(data, less.problem, less.size.between)
        base, base_sd = other.linear(less.z), other.sd(less.size)
        residual = residual_of(data, with_it)
        force = force_of(data, fit, name)
        distorted = residual.rows_of(distortions(residual, force)).T / sd[:, None]
        r, j = linear.residual / sd, linear.jacobian / sd[:, None]
        straight = log_z(r, j, fit.z)
        law = log_z(r, np.concatenate([j, distorted], axis=1), np.r_[fit.z, np.zeros(distorted.shape[1])])
        steady = 0.0
        if rows.evolving and not other.evolving:  # changes along the record that the smaller model has no rows of
            steady = rows.layout.steady_cost(less.size)
        without = log_z(base.residual / base_sd, base.jacobian / base_sd[:, None], less.z) - steady
        # what is left without it, in the rows of the larger model, whose own effects are off the base's reach
        left = linear.residual + residual.rows_of(force[None])[0]
        shared = [fit.problem.names.index(n) for n in less.problem.names]
        q, _ = np.linalg.qr(np.concatenate([j[:, shared], np.eye(len(shared))]))

        target = clear(left[None], sd, q)[0]
        pool = np.array([scrambled(x, residual, rng) for x in forces for _ in range(SCRAMBLED)])
        decoys = fitting(clear(residual.rows_of(pool), sd, q), target)
        best = float(np.mean([decoys[rng.permutation(len(decoys))[:BEST_OF]].max() for _ in range(200)]))
        real = float(fitting(clear(residual.rows_of(force[None]), sd, q), target)[0])
        tests = max(data.tests, 1)
        out[name] = {
            "law_error": float(np.arcsinh((law - without) / tests)),
            "distortion": float(-np.arcsinh((law - straight) / tests)),
            "decoys": float(np.log(max(real, 1e-9) / max(best, 1e-9))),
        }
    return out


def clear(rows: Array, sd: Array, reach: Array) -> Array:
    """Rows (n, m) in units of their sd (m,), without what the base can make: reach (m + k, k), orthonormal, its k
    priors last."""
    x = np.concatenate([rows / sd, np.zeros((len(rows), len(reach) - len(sd)))], axis=1)
    return np.asarray(x - (x @ reach) @ reach.T)


def scrambled(force: np.ndarray, residual: Residual, rng: np.random.Generator) -> np.ndarray:
    """A force with its tests exchanged, each at its own size, and its harmonics' phases turned alike in every test."""
    to, level = rng.permutation(len(force)), residual.data.level_N
    turn = np.exp(2j * np.pi * rng.uniform(size=residual.order.max() + 2))[residual.order]
    turned = force[to] * (level / level[to])[:, None] * np.where(residual.real, np.sign(turn.real), turn)
    return np.asarray(np.where(residual.weight > 0.0, turned, 0.0))


def fitting(decoys: Array, target: Array) -> Array:
    """Squared correlation of rows (n, m) with what is to be explained (m,)."""
    size = np.maximum(np.sum(decoys**2, axis=1), 1e-12)
    return np.asarray((decoys @ target) ** 2 / size / max(float(target @ target), 1e-12))


def found(shared: None, path: str) -> dict[str, Any]:
    with linear_algebra().limit(limits=1):
        return figures(*models(pickle.loads(Path(path).read_bytes())))


def gated(
    cases: Sequence[Case], stored: Mapping[int, Mapping[str, Mapping[str, float]]], name: str, least: float
) -> dict[str, Array]:
    """Scores where an effect is not named whose figure is below `least`; stored : by identity of the search."""

    def kept(f: Figures, search: Search, *more: Any) -> Figures:
        return replace(f, odd="low") if stored[id(search)][f.name][name] < least else f

    with patched([changed_by(kept)]):
        return scored(cases)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["figures", "score"])
    parser.add_argument("cases", type=Path, nargs="+")
    parser.add_argument("--figures", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--half", choices=HALVES, default="all")
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    if args.what == "figures":
        args.out.mkdir(parents=True, exist_ok=True)
        asked = {str(args.out / f"{p.stem}.json"): str(p) for p in args.cases}
        asked = {k: v for k, v in asked.items() if not Path(k).is_file()}
        for path, result in finished(asked, found, None, workers=args.workers, what="figures", unit="case"):
            if isinstance(result, Failure):
                print(f"{path}: {result}")
            else:
                write_whole(path, json.dumps(finite(result)))
        return
    stored = {p.stem: json.loads(p.read_text()) for p in args.figures.glob("*.json")} if args.figures else {}
    cases = [c for c in read_cases(args.cases, args.half) if Path(c.path).stem in stored]
    by_search = {id(c.found.search): stored[Path(c.path).stem] for c in cases}
    on, took = scored(cases), seconds_of(cases)
    rows = [row(f"nothing, {len(cases)} cases", on, on, (took, took))]
    for name, values in TRIED.items():
        for least in values:
            rows.append(row(f"{name} at least {least:g}", gated(cases, by_search, name, least), on, (took, took)))
    write(args.out, rows)
    found_by = [(c, c.found) for c in cases]
    named = [
        (by_search[id(w.search)], n, n in c.true)
        for c, w in found_by
        for n in named_by(w.figures, w.sets, unlisted_probability(w, calibration()))
    ]
    for name in TRIED:
        for title, right in (("true", True), ("false", False)):
            values = [v[n][name] for v, n, true in named if true is right and n not in MODEL_FORM]
            low, middle, high = np.quantile(values, [0.25, 0.5, 0.75]) if values else [np.nan] * 3
            print(f"{name} of {len(values)} {title} names: quartiles {low:.2f}, {middle:.2f}, {high:.2f}")


if __name__ == "__main__":
    main()
