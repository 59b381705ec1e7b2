"""How much of the differences between tests a stated condition explains: a pneumatic seal at 1 to 7 bar.

    python analyses/stated_condition.py [CAMPAIGN] [--seed 1]

The base model is fitted to all tests, then again with slip forces, stiffness or the force's zero following each
condition that the campaign states for its tests. For the base and for the best law: the RMS force of each test as
measured and as predicted, the share of its variance between tests that is explained, and the gap.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from bayes_iwan.campaign import read_campaign
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.fits.evidence import Fit, fit_model
from bayes_iwan.diagnosis.fits.gap_size import gap_size
from bayes_iwan.diagnosis.fits.residuals import residual_of
from bayes_iwan.diagnosis.search.base_fit import fit_base
from bayes_iwan.diagnosis.search.fitted_sets import calibrated
from bayes_iwan.effects.conditions import conditions_of, following
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.settings import DiagnoseSettings

SEAL = Path(__file__).parents[2] / "shared" / "data" / "pneumatic_seal"
#: z of the strength at which a refit starts, beside the base's optimum
STARTS = (-1.5, -0.5, 0.5, 1.5)


def with_effect(fit: Fit, effect, data) -> Fit:
    """The base and the effect, fitted together from several strengths."""
    problem = fit.problem.with_effects([effect])
    starts = np.zeros((len(STARTS), problem.ndim))
    starts[:, [problem.names.index(n) for n in fit.problem.names]] = fit.z
    starts[:, problem.names.index(effect.strength_name)] = STARTS
    return fit_model(data, problem, starts, iterations=40)


def tell(name: str, fit: Fit, data) -> None:
    measured, predicted = fit.problem.measured_N, fit.problem.predict(fit.z[None])[0]
    rms, told = (np.std(f, axis=1) for f in (measured, predicted))
    explained = 1.0 - np.sum((rms - told) ** 2) / np.sum((rms - rms.mean()) ** 2)
    print(f"{name}: gap {gap_size(residual_of(data, fit)).all.rms_N:.2f} N")
    print(f"    RMS force by test, measured  {' '.join(f'{x:6.2f}' for x in rms)} N")
    print(f"    RMS force by test, predicted {' '.join(f'{x:6.2f}' for x in told)} N")
    print(f"    share of its variance between tests that is explained: {explained:.2f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("campaign", type=Path, nargs="?", default=SEAL)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    loops = [x for x in read_campaign(args.campaign).loops(n_phase=80, n_harmonics=24) if x.role != "held-out"]
    scales, data = scales_of(loops), gap_data(loops)
    stated = conditions_of([x.extras for x in loops])
    if not stated:
        raise SystemExit(f"{args.campaign}: no number is stated for every test and differs between them")
    base = fit_base(data, DiagnoseSettings(), scales, np.random.default_rng(args.seed))
    tell("base", base, data)
    fits = {}
    for name, makers in following(stated).items():
        for maker in makers:
            effect = calibrated(maker, scales, data, base.problem, base.z)
            fits[name] = with_effect(base, effect, data)
            gain = fits[name].log_z.max() - base.log_z.max()
            values = fits[name].problem.prior.values(fits[name].z[None])
            own = ", ".join(f"{p.symbol} = {values[p.name][0]:.2f} {p.unit}" for p in effect.parameters)
            print(f"{name}: {own}; {gain:.0f} nats")
    best = max(fits, key=lambda n: fits[n].log_z.max())
    tell(best, fits[best], data)
