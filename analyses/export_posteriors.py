"""Sampled posteriors of random specimens, for export_round_trip.py.

    python analyses/export_posteriors.py --specimens 20 --seed 4401 --out runs

Each specimen is drawn by the virtual rig and tested three times (10 Hz at 0.4 and 0.9 mm, 18 Hz at 0.6 mm, six cycles
each). Two posteriors are sampled of each campaign: NN_varying with a varying normal force (the first five with the
default model, 27 parameters; then with two gammas of slip forces and without embedded model error), and NN_constant
with a constant normal force and stiffness and one gamma, which OpenSees' springs can hold. Two ensembles stop at R-hat
1.1, an effective size of 40 and four autocorrelation times, on loops of 64 points: less than for a report, since the
round trip asks whether draws survive the export, not how well they are known. Folders that are there are kept.
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path

import numpy as np

import bayes_iwan as bi
from bayes_iwan.inference.results import run_files
from bayes_iwan.virtual_rig.specimen import draw_specimen

TESTS = ((10.0, 0.4), (10.0, 0.9), (18.0, 0.6))
CHEAPER = {
    "sampling": {"r_hat": 1.1, "ess": 40.0, "taus": 4.0, "draws": 1024, "ensembles": 2, "budget_s": 900.0},
    "search": {"second_search": False},
    "loops": {"n_phase": 64, "n_harmonics": 25},
}
#: specimens that are identified with the default model
DEFAULTS = 5


def models(specimen: int) -> dict[str, dict[str, object]]:
    """Parts of the model by the end of the folder's name."""
    return {
        "varying": {} if specimen < DEFAULTS else {"slip": "gamma2", "embedded": False},
        "constant": {"slip": "gamma1", "normal_force": "constant", "stiffness": "constant", "embedded": False},
    }


def posterior_of(folder: Path, campaign: Path, model: dict[str, object], seed: int) -> str:
    """Sample one posterior into a folder; returns what the run says of itself."""
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a run that did not converge is said below
        config = {"model": model, **CHEAPER}
        posterior = bi.identify(campaign, seed=seed, progress=False, config=config)
    run_files.write(posterior, folder)
    return f"{posterior.message}, {posterior.ndim} parameters, {time.perf_counter() - start:.0f} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--specimens", type=int, default=20)
    parser.add_argument("--seed", type=int, default=4401)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    plan = [bi.PlannedTest(f, a, cycles=6) for f, a in TESTS]
    amplitudes, speed = [a for _, a in TESTS], max(2e-3 * np.pi * f * a for f, a in TESTS)
    for i in range(args.specimens):
        campaign = args.out / f"campaign_{i:02d}"
        if not campaign.exists():
            rng = np.random.default_rng([args.seed, i])
            specimen = draw_specimen(rng, (min(amplitudes), max(amplitudes)), speed)
            bi.simulate_campaign(plan, specimen=specimen, seed=args.seed + i).write(campaign)
        for name, model in models(i).items():
            folder = args.out / f"{i:02d}_{name}"
            if not folder.exists():
                print(f"{folder.name}: {posterior_of(folder, campaign, model, args.seed + i)}", flush=True)


if __name__ == "__main__":
    main()
