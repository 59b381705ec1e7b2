"""The forward model's time in several trees of this repository, side by side in one run.

    python analyses/benchmark_side_by_side.py TREE [TREE ...] [--rounds 2] [--repeats 400]

Nanoseconds a sample and draw on one thread: 32 draws, nine loops of 128 samples (short calls, the best of many, so that
other work on the machine disturbs little); the trees take turns. Normal force: Table 1 scattered by 20 %, one as
various as its prior, and Table 1 with the embedded model error. The last columns are the times over those of the first
tree.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

STAGES = ("whole", "alpha", "k", "table", "sliders")
#: what runs in each tree: prints {case: {stage: ns}}
CODE = """
import json, sys
sys.path[:0] = [sys.argv[1], sys.argv[1] + "/analyses"]
import numba as nb, numpy as np
import benchmark_forward as b
from bayes_iwan.models import Model, Reference, sine_motion
from bayes_iwan.models.kernels import sliders
from bayes_iwan.models import embedded_error
nb.set_num_threads(1)
draws, repeats, reference = 32, int(sys.argv[2]), Reference(1.0, 2e-3 * np.pi * 20.0)
motion = sine_motion(frequency_hz=np.tile([10.0, 15.0, 20.0], 3), amplitude_mm=np.repeat([0.3, 0.6, 1.0], 3))
per, rng, out, zero = 1e9 / (draws * 9 * 128), np.random.default_rng(1), np.empty((draws, 1, 9, 128)), np.zeros(draws)
various = {"normal_force_slope": 0.3 * rng.standard_normal(draws), "normal_force_rate": 0.3 *
rng.standard_normal(draws),
           "beta": rng.uniform(0.05, 1.5, draws)}
deviating = {name: 0.1 * rng.standard_normal(draws) for name in embedded_error.NAMES}
found = {}
for case, more, model in (("Table 1", {}, Model(reference)), ("various", various, Model(reference)),
                          ("embedded", deviating, Model(reference, embedded=True))):
    values = b.scattered(draws, reference) | more
    model.force(values, motion)
    alpha = model.alpha(values, motion)
    k = model.stiffness_law.k(values, alpha)
    table, top = model.slip_family.table(values)
    tables = np.ascontiguousarray(table)[:, None]
    calls = {
        "whole": lambda: model.force(values, motion),
        "alpha": lambda: model.alpha(values, motion),
        "k": lambda: model.stiffness_law.k(values, alpha),
        "table": lambda: model.slip_family.table(values),
        "sliders": lambda: sliders.friction(
                motion.displacement_mm, motion.slope_mm, alpha, k, zero, True, tables, top, zero, out
            ),
    }
    found[case] = {name: per * b.best(call, repeats) for name, call in calls.items()}
print(json.dumps(found))
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("trees", nargs="+", type=Path)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=400)
    args = parser.parse_args()
    best: dict[tuple[str, str, Path], float] = {}
    for _ in range(args.rounds):
        for tree in args.trees:
            command = [sys.executable, "-c", CODE, str(tree.resolve()), str(args.repeats)]
            ran = subprocess.run(command, capture_output=True, text=True, check=True, cwd="/")
            for case, stages in json.loads(ran.stdout).items():
                for stage, ns in stages.items():
                    best[case, stage, tree] = min(ns, best.get((case, stage, tree), ns))
    for case in dict.fromkeys(key[0] for key in best):
        for stage in STAGES:
            times = [best[case, stage, tree] for tree in args.trees]
            shown = (
                "".join(f"{t:8.2f}" for t in times)
                + "   over the first"
                + "".join(f"{t / times[0]:7.3f}" for t in times)
            )
            print(f"{case:10s}{stage:9s}{shown}")


if __name__ == "__main__":
    main()
