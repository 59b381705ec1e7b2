"""Do held-out tests lie inside the exported ensemble's bands as often as inside our own?

    python analyses/export_bands.py [CAMPAIGN ...] [--draws 20] [--sampled]

Default: data/rope_spring and three measured campaigns of ../shared/data, where these are. Tests with role "held-out"
are predicted; where a campaign has none, every third test is held out here. Identified quickly (Laplace's draws), or by
sampling. The bands are 90 % of the draws' forces, without noise: of all our draws, of those that are exported, and of
the exported step, which runs four cycles at each test's own amplitude and is compared in the last.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import bayes_iwan as bi
import export_courses as rt
from bayes_iwan.export.device import steady_loops
from bayes_iwan.export.exporting import source_of
from bayes_iwan.models.motion import motion_of
from bayes_iwan.models.simulator import FORCE_ZERO

HERE = Path(__file__).resolve().parents[1]
DEFAULT = [HERE / "data" / "rope_spring"]
DEFAULT += [HERE.parent / "shared" / "data" / n for n in ("mr_damper_half", "pneumatic_seal", "banded_damper_36")]

#: looser than for a report: the same draws are compared with what the export makes of them
SAMPLING = {"r_hat": 1.05, "ess": 100.0, "taus": 4.0, "budget_s": 900.0}


def with_held_out(campaign: bi.Campaign) -> bi.Campaign:
    """The campaign, every third test held out where none is."""
    if any(t.role == "held-out" for t in campaign.tests):
        return campaign
    tests = [replace(t, role="held-out") if i % 3 == 1 else t for i, t in enumerate(campaign.tests)]
    return replace(campaign, tests=tuple(tests))


def exported_loops(folder: Path, loops, draws: int) -> np.ndarray:
    """(1 + draws, tests, samples) forces of the C step in its fourth cycle."""
    isolator, out = rt.module(folder), []
    for x in loops:
        u, v, a = (np.tile(1e-3 * y, 4) for y in (x.displacement_mm, 1e3 * x.velocity_m_s, 1e3 * x.acceleration_m_s2))
        h, n = 1.0 / (x.frequency_hz * len(x.phase)), len(x.phase)
        each = [isolator.Isolator(d, 1e-3 * x.amplitude_mm).run(h, u, v, a)[-n:] for d in range(1 + draws)]
        out.append(each)
    return np.swapaxes(np.array(out), 0, 1)


def inside(force: np.ndarray, measured: np.ndarray) -> float:
    """Share of samples within the draws' 5 and 95 % quantiles, %."""
    low, high = np.quantile(force, [0.05, 0.95], axis=0)
    return float(100.0 * np.mean((measured >= low) & (measured <= high)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaigns", nargs="*")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--sampled", action="store_true")
    args = parser.parse_args()
    print("| campaign | draws | held-out tests | inside all our draws, % | our exported draws, % | the export, % | "
          "largest difference of the two, % of RMS |\n|---|---|---|---|---|---|---|")  # fmt: skip
    for name in map(Path, args.campaigns or DEFAULT):
        if not name.is_dir():
            print(f"| {name.name} | not here | | | | | |")
            continue
        campaign = with_held_out(bi.read_campaign(name))
        posterior = bi.identify(campaign, quick=not args.sampled, seed=1, progress=False, config={"sampling": SAMPLING})
        held = [x for x in campaign.loops() if x.role == "held-out"]
        folder = Path(tempfile.mkdtemp())
        posterior.export("c", folder, draws=args.draws)
        measured = np.stack([x.force_N for x in held])

        def ours(z: np.ndarray, held=held, problem=posterior.problem) -> tuple[np.ndarray, np.ndarray]:
            values = problem.parameter_values(z)
            zero = values[FORCE_ZERO][:, None, None]
            return steady_loops(problem, values, motion_of(held)) + zero, zero

        every, _ = ours(posterior.flat_z(2000))
        same, zero = ours(source_of(posterior, args.draws, None, None).z)
        theirs = exported_loops(folder, held, args.draws) + zero
        difference = np.sqrt(np.mean((theirs - same) ** 2, axis=2) / np.mean(same**2, axis=2)).max()
        cells = [f"{inside(x, measured):.1f}" for x in (every, same[1:], theirs[1:])]
        cells = [name.name, "sampled" if args.sampled else "quick", str(len(held)), *cells, f"{100 * difference:.2g}"]
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
