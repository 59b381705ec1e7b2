"""Does one genetic search, polished by least squares, reach the best known optimum?

    python analyses/point_recovery.py [--seeds 6] [--campaigns data/rope_spring data/withheld/case_01 ...]

Ten campaigns (rope_spring and nine of the withheld ones unless named), each searched with other seeds. Found is a most
probable point within 0.1 nat of the best that any of the searches of its campaign has found. Before it: loops of
Table 1's isolator without noise, where the minimum of Eq. (8) is known to be zero.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from bayes_iwan.campaign import Loop, Record, average, read_campaign
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.setup.settings import SearchSettings
from bayes_iwan.inference.solving.point import find_point
from bayes_iwan.models import Model, Reference, sine_motion
from bayes_iwan.models.normal_force import from_paper_hunt_crossley
from bayes_iwan.models.stiffness import from_paper_stiffness

TESTS = [(f, a) for f in (10.0, 15.0, 20.0) for a in (0.3, 0.6, 1.0)]
REFERENCE = Reference(1.0, 0.12566)


def true_values() -> dict[str, np.ndarray]:
    """Table 1's spring, stiffness and slip forces, with k̃ₙ = 0.6, λ = 1.1 s/m, β = 0.6."""
    plain = {
        "kp_N_mm": 5.49,
        "force_zero_N": 0.0,
        "t1_N": 0.24,
        "eta1": 0.95,
        "g1": 0.41,
        "t2_N": 0.36,
        "eta2": 5.1,
        "g2": 0.53,
        "t3_N": 0.5,
        "eta3": 4.4,
        "g3": 0.06,
    }
    return (
        {k: np.array([v]) for k, v in plain.items()}
        | from_paper_stiffness(19.62, 30.37)
        | from_paper_hunt_crossley(0.6, 1.1, 0.6, REFERENCE)
    )


def known_loops(noise_N: float = 0.0, seed: int = 0, cycles: int = 8) -> tuple[Loop, ...]:
    """Averaged loops of TESTS, 512 samples a cycle, with white noise of 2 noise_N on every sample, so that harmonics
    have the noise of 128 samples with noise_N each."""
    motion = sine_motion(frequency_hz=[f for f, _ in TESTS], amplitude_mm=[a for _, a in TESTS], samples=512)
    force = Model(REFERENCE).force(true_values(), motion)[0]
    loops = []
    for k, (f, a) in enumerate(TESTS):
        time_s = np.arange(512 * cycles) / (512 * f)
        noise = 2.0 * noise_N * np.random.default_rng([seed, k]).standard_normal(time_s.size)
        loops.append(
            average(
                Record(
                    f"f{f:g}_a{a:g}.csv",
                    f,
                    a,
                    "fit",
                    {},
                    time_s,
                    a * np.sin(2.0 * np.pi * f * time_s),
                    np.tile(force[k], cycles) + noise,
                )
            )
        )
    return tuple(loops)


def searched(campaign: Path, seeds: int) -> np.ndarray:
    """ln p of the most probable point that one search of each seed finds, (seeds,)."""
    problem = make_problem(read_campaign(campaign).loops())
    settings = SearchSettings(second_search=False)
    return np.array([find_point(problem, seed, settings, progress=False).log_prob for seed in range(seeds)])


def main(seeds: int, campaigns: list[Path]) -> int:
    """Runs that missed their campaign's best known optimum."""
    exact = find_point(make_problem(known_loops()), 0, SearchSettings(second_search=False), progress=False)
    print(f"without noise: Eq. (8) ends at {100 * exact.goal_share:.4f} % of what it makes of the friction force")
    missed = 0
    for campaign in campaigns:
        began = time.perf_counter()
        found = searched(campaign, seeds)
        short = found.max() - found
        missed += int(np.sum(short > 0.1))
        print(
            f"{campaign.name:20s} best ln p {found.max():.2f}; nats below it, seed by seed: "
            + " ".join(f"{x:.2f}" for x in short)
            + f"; {(time.perf_counter() - began) / seeds:.1f} s a search",
            flush=True,
        )
    total = seeds * len(campaigns)
    print(f"found in {total - missed} of {total} searches")
    return missed


if __name__ == "__main__":
    data = Path(__file__).parent.parent / "data"
    ten = [data / "rope_spring", *sorted((data / "withheld").glob("case_*"))[::3][:9]]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--campaigns", nargs="+", type=Path, default=ten)
    args = parser.parse_args()
    sys.exit(0 if main(args.seeds, args.campaigns) <= 0.05 * args.seeds * len(args.campaigns) else 1)
