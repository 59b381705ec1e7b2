"""What each law of the catalogue adds to the cost of a prediction, and to the numbers of a refit.

    python analyses/benchmark_laws.py [--draws 32] [--repeats 30]

A refit calls the model for some thirty draws at a time on a campaign's loops: here nine of 80 samples. Costs are over
the same model without an effect (the best of the repeats); laws that evolve along the records, or compare tests, act
block by block, and cost the number of blocks more.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from bayes_iwan.effects import catalogue
from bayes_iwan.effects.base import Effect
from bayes_iwan.models import Model, Scales, sine_motion
from bayes_iwan.models.paper_parameters import table_1
from bayes_iwan.models.simulator import recorded_force

SCALES = Scales(length_mm=1.0, speed_m_s=0.12566, force_N=4.0, slip_N=1.2, soft_N_mm=5.5, stiff_N_mm=15.0)
FILES = tuple(f"{i}.csv" for i in range(9))


def best_ms(effects: tuple[Effect, ...], draws: int, repeats: int) -> float:
    """Best time of a prediction, ms, at half a standard deviation above the medians of the effects' priors."""
    model = Model(SCALES.reference)
    parameter_values = {n: np.repeat(np.atleast_1d(v), draws) for n, v in table_1(SCALES.reference).items()}
    for p in (p for e in effects for p in e.parameters):
        parameter_values[p.name] = np.full(draws, float(p.value(np.full(1, 0.5))[0]))
    motion = sine_motion(
        frequency_hz=np.repeat([10.0, 15.0, 20.0], 3), amplitude_mm=np.tile([0.3, 0.6, 1.0], 3), samples=80
    )
    recorded_force(model, effects, parameter_values, motion)
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        recorded_force(model, effects, parameter_values, motion)
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=32)
    parser.add_argument("--repeats", type=int, default=30)
    args = parser.parse_args()
    plain = best_ms((), args.draws, args.repeats)
    print(f"plain model: {plain:.2f} ms for {args.draws} draws of nine loops")
    print(f"{'effect':30s} {'class':28s} numbers  tried  cost")
    for kind in (*catalogue.BUILT_IN, *catalogue.FORM, *catalogue.UNLISTED):
        effect = kind(SCALES, FILES)
        cost = best_ms((effect,), args.draws, args.repeats) / plain
        print(f"{kind.name:30s} {kind.__name__:28s} {len(effect.parameters):7d} {len(effect.scanned):6d}  {cost:.2f}")
