"""Sampled posteriors of random specimens, for export_round_trip.py.

    python analyses/export_posteriors.py --specimens 20 --seed 4401 --out runs

Each specimen is drawn by the virtual rig and tested three times (10 Hz at 0.4 and 0.9 mm, 18 Hz at 0.6 mm, six cycles
each). Two posteriors are sampled of each campaign by the default settings (R-hat 1.01, an effective size of 400):
NN_constant with a constant normal force and stiffness and without embedded model error, which OpenSees' springs can
hold, and NN_varying with the default model. Only the time that a run may take is another (--budget, s); --quick ends
with the first draws that count. Runs that are there are kept, interrupted ones go on.
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path

import numpy as np

import bayes_iwan as bi
from bayes_iwan.sampling.checkpoint import NAME as CHECKPOINT
from bayes_iwan.virtual_rig.specimen import draw_specimen

TESTS = ((10.0, 0.4), (10.0, 0.9), (18.0, 0.6))
#: parts of the model by the end of the folder's name
MODELS: dict[str, dict[str, object]] = {
    "constant": {"normal_force": "constant", "stiffness": "constant", "embedded": False},
    "varying": {},
}


def posterior_of(folder: Path, campaign: Path, model: dict[str, object], seed: int, budget_s: float | None) -> str:
    """Sample one posterior into a folder, or take quick draws (no budget); returns what the run says of itself."""
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a run that did not converge is said below
        config = {"model": model} | ({} if budget_s is None else {"sampling": {"budget_s": budget_s}})
        begun = (folder / CHECKPOINT).exists()
        quick = budget_s is None
        posterior = bi.identify(campaign, folder, seed=seed, progress=False, config=config, resume=begun, quick=quick)
    return f"{posterior.message}, {posterior.ndim} parameters, {time.perf_counter() - start:.0f} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--specimens", type=int, default=20)
    parser.add_argument("--seed", type=int, default=4401)
    parser.add_argument("--budget", type=float, default=900.0)
    parser.add_argument("--quick", action="store_true", help="the first draws that count instead")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    budget_s = None if args.quick else args.budget
    plan = [bi.PlannedTest(f, a, cycles=6) for f, a in TESTS]
    amplitudes, speed = [a for _, a in TESTS], max(2e-3 * np.pi * f * a for f, a in TESTS)
    for i in range(args.specimens):
        campaign = args.out / f"campaign_{i:02d}"
        if not campaign.exists():
            rng = np.random.default_rng([args.seed, i])
            specimen = draw_specimen(rng, (min(amplitudes), max(amplitudes)), speed)
            bi.simulate_campaign(plan, specimen=specimen, seed=args.seed + i).write(campaign)
    for name, model in MODELS.items():
        for i in range(args.specimens):
            folder, campaign = args.out / f"{i:02d}_{name}", args.out / f"campaign_{i:02d}"
            if not (folder / "posterior.nc").exists():
                print(f"{folder.name}: {posterior_of(folder, campaign, model, args.seed + i, budget_s)}", flush=True)


if __name__ == "__main__":
    main()
