"""Two simple methods on the same campaigns: sparse regressions of the base model's residual on a dictionary of terms.

    python analyses/baselines.py FITS/*.pickle --out BASELINES [--workers 2]

FITS are cases of `study_fits.py`; the campaigns are read where `study_draws.py` left them. The base model is fitted
as a diagnosis fits it. What its parameters can imitate, within their priors, is projected off its residual and off
every term of the dictionary: displacement, velocity, acceleration, their products and powers, sign terms, and what a
lag, a filter or a drift of either channel would add. Each term stands for one effect of the catalogue.

spike and slab: every set of up to MOST terms, weighted by its Bayesian information criterion and by a prior of SLAB a
term; an effect's probability is the weight of the sets that have a term of it (George & McCulloch, J. Am. Stat. Assoc.
88 (1993) 881; weights: Raftery, Sociol. Methodol. 25 (1995) 111).
discrepancy regression: least squares on all terms, those with little part in the residual dropped in turn; the term
with the largest part gives the name where a half of the residual is explained (Kaheman et al., arXiv 1909.08574; Ebers
et al., SIAM J. Appl. Dyn. Syst. 23 (2024) 440).
Both are scored by `study_cases.py`, as the diagnosis is. Neither names anything from one record.
"""

from __future__ import annotations

import argparse
import json
import pickle
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import average
from bayes_iwan.diagnosis.answer.saved_fits import LOOPS
from bayes_iwan.diagnosis.assessment.calibration import calibration
from bayes_iwan.diagnosis.constants import PROBABLE, USUAL_GAP
from bayes_iwan.diagnosis.fits.data import TREND_HARMONICS, gap_data
from bayes_iwan.diagnosis.fits.evidence import Fit
from bayes_iwan.diagnosis.fits.residuals import MAINS, MEAN, Residual, residual_of
from bayes_iwan.diagnosis.search.base_fit import fit_base
from bayes_iwan.effects.base import moved_by
from bayes_iwan.executors import Failure, finished
from bayes_iwan.files import write_json
from bayes_iwan.inference.setup.loop_error import harmonics_of
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.threads import linear_algebra
from study_cases import HALVES, Answer, Case, counts, read_cases, table

#: terms in a set, prior of each; ridge of discrepancy regression, and share of the residual below which it drops a term
MOST, SLAB, RIDGE, LEAST_PART = 3, 0.05, 0.05, 0.1
#: harmonics that are regressed, and share of the friction level by which each may differ without a cause
HARMONICS, FLOOR = 12, 0.002
#: what follows speed has one term, whose sign gives the name
BY_SIGN = {"rate": ("rate_strengthening", "stribeck_weakening")}


def steady_terms(fit: Fit, residual: Residual) -> list[tuple[str, Array]]:
    """Effect and (tests, samples) force of each term that repeats with the cycle."""
    motion, scales = residual.data.steady_motion, scales_of(residual.data.loops)
    values = fit.problem.parameter_values(fit.z[None])
    force, friction = fit.problem.force(values, motion)[0], fit.problem.friction_force(values, motion)[0]
    u, v = motion.displacement_mm[0] / scales.length_mm, motion.velocity_m_s[0] / scales.speed_m_s
    n = u.shape[1]
    turns = 2.0 * np.pi * motion.frequency_hz[:, None] * np.arange(n // 2 + 1)

    def filtered(signal: Array, gain: np.ndarray) -> Array:
        return np.fft.irfft(np.fft.rfft(signal) * np.where(turns > 0.0, gain, 0.0), n)

    def read(change: Array) -> Array:
        """The force where the displacement is read wrongly by this shape."""
        step = 1e-3 * scales.length_mm * change / max(float(np.sqrt(np.mean(change**2))), 1e-300)
        return np.asarray(fit.problem.force(values, moved_by(motion, motion.displacement_mm + step))[0] - force)

    slow, fast = 1.0 / turns[:, 1].min(), 1.0 / turns[:, 1].max()
    over = 1.0 / np.where(turns > 0.0, 1j * turns, 1.0)
    branches = [1j * turns * tau for tau in (0.3 * fast, np.sqrt(fast * slow), 3.0 * slow)]
    return [
        ("viscous_damping", v),
        ("speed_squared", v * np.abs(v)),
        *(("maxwell_branch", filtered(u, x / (1.0 + x))) for x in branches),
        ("moving_mass", motion.acceleration_m_s2[0]),
        ("quadratic_stiffness", u**2),
        ("cubic_stiffness", u**3),
        *(("end_stop", np.maximum(side * u - gap, 0.0)) for gap in (0.5, 0.8) for side in (-1.0, 1.0)),
        *(("rate", friction * np.log1p(np.abs(v) / v_0)) for v_0 in (0.03, 0.3)),
        ("direction_dependent_friction", friction * np.sign(v)),
        ("normal_force_lag", friction * v),
        ("rig_compliance", read(-force)),
        ("free_play", read(-np.tanh(20.0 * force / scales.force_N))),
        ("integration_highpass", read(filtered(u, over))),
        ("channel_delay", filtered(force, np.expm1(-0.05j * turns * fast))),
        ("force_lowpass", filtered(force, 1.0 / (1.0 + 0.3j * turns * fast) - 1.0)),
        ("force_highpass", filtered(force, over)),
        ("force_clipping", force**3),
    ]


def terms(fit: Fit, residual: Residual) -> tuple[list[str], np.ndarray]:
    """Effects and (terms, T, M) complex terms in the numbers of a residual."""
    data, count = residual.data, residual.data.harmonics_N.shape[1]
    loops = [(name, harmonics_of(signal, count)) for name, signal in steady_terms(fit, residual)]
    spring = harmonics_of(data.steady_motion.displacement_mm[0], count)
    whole = harmonics_of(fit.problem.force(fit.problem.parameter_values(fit.z[None]), data.steady_motion)[0], count)
    friction = whole - float(np.vdot(spring, whole).real / np.vdot(spring, spring).real) * spring
    ramp = data.ramps[1][..., 0].real  # (tests, blocks): time from the record's start
    change = np.einsum("tkb,tb->tk", data.contrast, ramp)[:, :, None]
    still = np.tile(np.eye(1, count), (data.tests, 1))
    names = [name for name, _ in loops] + ["friction_fade", "spring_softening", "force_drift", "mains_interference"]
    out = np.zeros((len(names), *residual.value.shape), complex)
    out[: len(loops), :, :count] = [x for _, x in loops]
    for i, x in enumerate((friction, spring, still), len(loops)):
        out[i, :, :count] = x * ramp.mean(axis=1)[:, None]
        out[i, :, count:-2] = (change * x[:, None, : TREND_HARMONICS + 1]).reshape(data.tests, -1)
    out[-1] = np.where(residual.kind == MAINS, residual.value, 0.0)
    return names, out


def regression(fit: Fit, residual: Residual) -> tuple[list[str], Array, Array, Array]:
    """Effects, (rows, terms) of unit length and (rows,) residual, both without what the base can imitate, and how many
    numbers each term costs."""
    names, some = terms(fit, residual)
    kept = (residual.weight > 0.0) & (residual.kind != MEAN)[None] & (residual.order <= HARMONICS)[None]
    sd = np.hypot(residual.allowed, FLOOR * residual.data.level_N[:, None])[kept]

    def rows(x: np.ndarray) -> Array:
        return np.concatenate([x[..., kept].real / sd, x[..., kept].imag / sd], axis=-1)

    y, x, j = rows(residual.value), rows(some), rows(residual.slope)
    q, _ = np.linalg.qr(np.concatenate([j.T, np.eye(len(j))]))
    y, x = np.r_[y, np.zeros(len(j))], np.concatenate([x, np.zeros((len(x), len(j)))], axis=1).T
    y, x = y - q @ (q.T @ y), x - q @ (q.T @ x)
    cost = np.where(np.array(names) == "mains_interference", 2.0 * residual.data.tests, 1.0)
    return names, x / np.maximum(np.linalg.norm(x, axis=0), 1e-9), y, cost


def spike_and_slab(names: list[str], x: Array, y: Array, cost: Array) -> tuple[dict[str, float], float]:
    """Probability of each effect, and the share of the residual (RMS) that the best set leaves."""
    n, gram, right, total = len(y), x.T @ x, x.T @ y, float(y @ y)
    sets, weight, left = [], [], []
    for k in range(MOST + 1):
        for some in combinations(range(len(names)), k):
            at = list(some)
            b = np.linalg.lstsq(gram[np.ix_(at, at)], right[at], rcond=1e-6)[0] if k else np.zeros(0)
            remains = max(total - float(b @ right[at]), 1e-9 * total)
            prior = k * np.log(SLAB) + (len(names) - k) * np.log(1.0 - SLAB)
            weight.append(-0.5 * (n * np.log(remains / n) + float(cost[at].sum()) * np.log(n)) + prior)
            sets.append({spoken(names[i], c) for i, c in zip(some, b)})
            left.append(remains / total)
    p = np.exp(np.array(weight) - np.logaddexp.reduce(weight))
    every = sorted(set().union(*sets))
    return {e: float(sum(w for w, s in zip(p, sets) if e in s)) for e in every}, float(np.sqrt(left[int(p.argmax())]))


def discrepancy_regression(names: list[str], x: Array, y: Array, cost: Array) -> tuple[dict[str, float], float]:
    """The effect whose term has the largest part in the residual, with the share that is explained as its probability;
    and the share of the residual (RMS) that is left."""
    kept, size = np.flatnonzero(cost < len(y)), float(np.linalg.norm(y))
    while True:
        some = x[:, kept]
        b = np.linalg.solve(some.T @ some + RIDGE * np.eye(len(kept)), some.T @ y)
        few = np.abs(b) < LEAST_PART * size
        if not few.any() or few.all():
            break
        kept = kept[~few]
    left, top = float(np.linalg.norm(y - some @ b)) / size, int(np.argmax(np.abs(b)))
    return {spoken(names[kept[top]], b[top]): 1.0 - left}, left


def spoken(name: str, coefficient: float) -> str:
    """The effect of a term with this coefficient."""
    return BY_SIGN[name][int(coefficient < 0.0)] if name in BY_SIGN else name


METHODS = {"spike and slab": (spike_and_slab, PROBABLE), "discrepancy regression": (discrepancy_regression, PROBABLE)}


def answered(shared: None, path: str) -> dict[str, Any]:
    """What both say of one campaign."""
    loops = [average(r, **LOOPS) for r in pickle.loads(Path(path).read_bytes())["records"]]
    with linear_algebra().limit(limits=1):
        data = gap_data(loops)
        fit = fit_base(data, DiagnoseSettings(), scales_of(loops), np.random.default_rng([0, 1]))
        given = regression(fit, residual_of(data, fit))
        return {title: method(*given) for title, (method, _) in METHODS.items()}


def answer(case: Case, p: dict[str, float], left: float, least: float) -> Answer:
    """An answer; the unexplained part is flagged as the diagnosis flags it, by its size."""
    before, p = case.gap, {n: v for n, v in p.items() if n != "speed_squared"}
    sure = frozenset(n for n, v in p.items() if v >= least and before > USUAL_GAP and case.found.search.data.tests > 1)
    left = before * (left if sure else 1.0)
    return Answer(sure, sure, p, calibration().unknown_cause(left), left, astray=sure - case.true)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--half", choices=HALVES, default="all")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    cases = read_cases(args.cases, args.half)
    store = {c.path: args.out / f"{Path(c.path).stem}.json" for c in cases}
    asked = {p: p for p, at in store.items() if not at.is_file()}
    for path, found in finished(asked, answered, None, workers=args.workers, what="baselines", unit="case"):
        print(f"{path}: {found}") if isinstance(found, Failure) else write_json(store[path], found)
    for title, (_, least) in METHODS.items():
        some = [(c, json.loads(store[c.path].read_text())[title]) for c in cases if store[c.path].is_file()]
        print(f"{title}, {len(some)} cases", *table([counts(c, answer(c, *x, least)) for c, x in some]), sep="\n")


if __name__ == "__main__":
    main()
