"""Add a cause of your own to the diagnosis: one file, no other change.

    python analyses/own_effect.py --out runs/own_effect [--effect analyses/effects/quadratic_drag.py]

A campaign is simulated on the virtual rig with quadratic drag, which the catalogue does not hold. It is diagnosed
twice: without the file the answer must do without that name; with it the drag should be found.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import bayes_iwan as bi
from bayes_iwan.campaign import Record, write_campaign
from bayes_iwan.virtual_rig.planning import simulate_campaign
from bayes_iwan.virtual_rig.simulate import PlannedTest


def with_drag(records: tuple[Record, ...], drag_N_s2_m2: float) -> list[Record]:
    """The same records with drag added to the measured force, from the recorded motion's own speed."""
    out = []
    for r in records:
        v = 1e-3 * np.gradient(smooth(r.displacement_mm, r), r.time_s)
        out.append(
            Record(
                r.file,
                r.frequency_hz,
                r.amplitude_mm,
                r.role,
                r.extras,
                r.time_s,
                r.displacement_mm,
                r.force_N + drag_N_s2_m2 * v * np.abs(v),
            )
        )
    return out


def smooth(signal: np.ndarray, record: Record) -> np.ndarray:
    """The signal without what lies above five times the test's frequency: sensor noise would spoil the speed."""
    spectrum = np.fft.rfft(signal)
    f = np.fft.rfftfreq(signal.size, float(np.median(np.diff(record.time_s))))
    return np.fft.irfft(np.where(f < 5.5 * record.frequency_hz, spectrum, 0.0), signal.size)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/own_effect"))
    parser.add_argument("--effect", default=str(Path(__file__).parent / "effects" / "quadratic_drag.py"))
    parser.add_argument("--drag", type=float, default=12.0, help="N·s²/m² (default: 12)")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--full", action="store_true", help="sample the leading causes, too; takes longer")
    args = parser.parse_args()
    plan = [PlannedTest(f, a) for f in (6.0, 13.0, 31.0) for a in (0.3, 0.9)]
    campaign = args.out / "campaign"
    if not (campaign / "campaign.toml").exists():
        sound = simulate_campaign(plan, seed=args.seed)
        write_campaign(
            campaign,
            name="a spring with drag",
            description="virtual rig, quadratic drag added",
            tests=with_drag(sound.records, args.drag),
            source="analyses/own_effect.py",
        )
    for name, file in (("catalogue alone", None), ("with the file", args.effect)):
        out = args.out / name.replace(" ", "_")
        answer = bi.diagnose(campaign, out, seed=args.seed, quick=not args.full, effects=file or ()).to_dict()
        ranked = sorted(answer["probabilities"].items(), key=lambda x: -x[1])[:4]
        print(f"{name}: " + ", ".join(f"{cause} {p:.2f}" for cause, p in ranked))
        print("    " + "\n    ".join(answer["sentences"]))
