"""Identify and diagnose models that are not of the Iwan model's shape, each with an effect planted, and draw them.

    python analyses/other_models.py --out runs/other_models

A linear spring with viscous and structural damping has a cubic spring planted, a Dahl element friction that weakens
with speed. Each is one file (analyses/simulators). The diagnosis starts from the model without the effect; the figure
shows what the model alone misses, what is left with the cause that it names, and the probabilities.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import bayes_iwan as bi
from bayes_iwan.campaign import Campaign, Record, write_campaign
from bayes_iwan.effects.catalogue import BUILT_IN
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.models import Simulator, sine_motion
from bayes_iwan.models.simulator import recorded_force
from bayes_iwan.models.user_file import load_simulator

SIMULATORS = Path(__file__).parent / "simulators"
TESTS = tuple((f, a) for f in (5.0, 10.0, 20.0) for a in (0.4, 1.0))
#: simulator: its true numbers, the planted effect and that effect's
PLANTED = {
    "damped_spring": (
        {"k_N_mm": 6.0, "eta": 0.12, "c_N_s_mm": 2e-3},
        "cubic_stiffness",
        {"k3_N_mm3": 0.4},
    ),
    "dahl": (
        {"kp_N_mm": 5.0, "dahl_force_N": 1.2, "dahl_k_N_mm": 15.0},
        "stribeck_weakening",
        {"drop": 0.3, "v_s_m_s": 0.02, "memory_s": 1e-4},
    ),
}


def made(name: str, noise_N: float = 0.01, cycles: int = 16, rate_hz: float = 1280.0, seed: int = 0) -> Campaign:
    """Sines on a simulator with its planted effect, white noise on the force."""
    simulator = load_simulator(SIMULATORS / f"{name}.py")
    parameter_values, cause, strength = PLANTED[name]
    kind = next(e for e in BUILT_IN if e.name == cause)
    own = {k: np.array([v]) for k, v in parameter_values.items()}
    effect = kind(scales_of(_campaign(simulator, own, (), 0.0, cycles, rate_hz, seed).loops()))
    return _campaign(simulator, own | effect.values_at(**strength), (effect,), noise_N, cycles, rate_hz, seed)


def _campaign(simulator: Simulator, parameter_values, effects, noise_N, cycles, rate_hz, seed) -> Campaign:
    records = []
    for i, (f, a) in enumerate(TESTS):
        samples = round(rate_hz / f)
        loop = recorded_force(
            simulator, effects, parameter_values, sine_motion(frequency_hz=[f], amplitude_mm=[a], samples=samples)
        )[0, 0]
        time = np.arange(cycles * samples) / rate_hz
        noise = noise_N * np.random.default_rng([seed, i]).standard_normal(time.size)
        u = a * np.sin(2.0 * np.pi * f * time)
        records.append(Record(f"f{f:g}_a{a:g}.csv", f, a, "fit", {}, time, u, np.tile(loop, cycles) + noise))
    return Campaign(simulator.name, "", "", "", Path(simulator.name), tuple(records))


def figure(found: dict[str, dict], folder: Path) -> None:
    """Gap before and after, and the likeliest answers, one row a model."""
    sheet, axes = plt.subplots(len(found), 2, figsize=(8.0, 2.2 * len(found)), layout="constrained", squeeze=False)
    for (name, answer), (left, right) in zip(found.items(), axes):
        gap = answer["gap"]
        bars = {"model alone": gap["before_rms_N"], "with the cause": gap["after_rms_N"], "noise": gap["noise_rms_N"]}
        left.barh(list(bars), [1e3 * v for v in bars.values()], color=["tab:red", "tab:blue", "grey"])
        left.set(title=f"{name}: what is missed", xlabel="RMS force / mN")
        left.invert_yaxis()
        ranked = sorted(answer["probabilities"].items(), key=lambda x: -x[1])[:4]
        planted = PLANTED[name][1]
        right.barh(
            [n.replace("_", " ") for n, _ in ranked],
            [p for _, p in ranked],
            color=["tab:blue" if n == planted else "lightgrey" for n, _ in ranked],
        )
        right.set(title=f"planted: {planted.replace('_', ' ')}", xlabel="probability", xlim=(0, 1))
        right.invert_yaxis()
    folder.mkdir(parents=True, exist_ok=True)
    sheet.savefig(folder / "other_models.svg")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/other_models"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--full", action="store_true", help="sample the leading causes, too; takes longer")
    args = parser.parse_args()
    answers = {}
    for name in PLANTED:
        campaign, out = made(name, seed=args.seed), args.out / name
        if not (out / "campaign" / "campaign.toml").exists():
            write_campaign(out / "campaign", name=name, description=f"made by {name}.py", tests=campaign.tests)
        file = SIMULATORS / f"{name}.py"
        bi.diagnose(out / "campaign", out, seed=args.seed, quick=not args.full, simulator=file)
        answers[name] = json.loads((out / "diagnosis.json").read_text())
        print(f"{name}:\n    " + "\n    ".join(answers[name]["sentences"]))
    figure(answers, args.out)
    print(f"{args.out / 'other_models.svg'}")
