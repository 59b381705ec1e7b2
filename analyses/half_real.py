"""Half-real cases: known effects put into real recordings, to be found on top of the gap that these have anyway.

    python analyses/half_real.py --data ../shared/data --out half_real [--cases 48] [--workers 2]

Each real campaign is searched as it is first. Its leading fit, effects held, is the base model of what follows. Then
delay, high-pass of force or displacement, a mass, a drift or a fade of friction is applied to the measured signals,
at a size of 6 to 20 % of the friction force, the loops are averaged anew, and the added cause is sought: on top of
the misfit of each loop that the first diagnosis found (--know loops), or of a smooth misfit of which only the size
is known (--know size, the harder question: misfits here are 5 to 20 % of the friction force themselves).
Both recordings are one and share their noise, which is counted twice all the same.
"""

from __future__ import annotations

import argparse
import os
import textwrap
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import interpolate, signal
from tqdm import tqdm

from bayes_iwan.campaign import Campaign, Record, read_campaign
from bayes_iwan.effects import catalogue
from bayes_iwan.gap.attribution import Table
from bayes_iwan.gap.data import gap_data
from bayes_iwan.gap.diagnosis import write_json
from bayes_iwan.gap.saved_fits import LOOPS
from bayes_iwan.gap.search import search
from bayes_iwan.inference.scales import scales_of
from bayes_iwan.validation import known_gap as on_top
from bayes_iwan.validation.estimates import bootstrap, share
from runs import each

#: campaign folder and the tests taken (None: all). The seal's pressures are different normal forces, each on its own
SOURCES = {
    "microtribometer": ("microtribometer", None),
    "damper, 0 A": ("mr_damper_off", None),
    "damper, 0.5 A": ("mr_damper_half", None),
    "seal, 1 bar": ("pneumatic_seal", "p1bar.csv"),
    "seal, 7 bar": ("pneumatic_seal", "p7bar.csv"),
}
SIZES = (0.06, 0.20)
#: harmonics of the displacement from which a mass's acceleration is taken, as many as loops are averaged with
BAND = 24.0


def _lowpass(values: np.ndarray, record: Record, corner_hz: float) -> np.ndarray:
    """First-order low-pass of a channel that has settled long before the record began, any time steps."""
    time_s = record.time_s - record.time_s[0]
    grid = np.linspace(0.0, time_s[-1], 2 * len(time_s))
    a = -np.expm1(-2.0 * np.pi * corner_hz * grid[1])
    filtered, _ = signal.lfilter([a], [1.0, a - 1.0], np.interp(grid, time_s, values), zi=[(1.0 - a) * values.mean()])
    # the state at the start is whatever leaves no decaying part beside the cycles
    decay, turn = np.exp(-2.0 * np.pi * corner_hz * grid), 2.0 * np.pi * record.frequency_hz * grid
    waves = [g(h * turn) for h in (1, 2, 3) for g in (np.cos, np.sin)]
    share = np.linalg.lstsq(np.stack([decay, np.ones_like(grid), *waves], axis=1), filtered, rcond=None)[0]
    return np.interp(time_s, grid, filtered - share[0] * decay)


def _acceleration_m_s2(record: Record) -> np.ndarray:
    """Second derivative of the displacement's first harmonics."""
    grid = np.linspace(record.time_s[0], record.time_s[-1], len(record.time_s))
    rate = (len(grid) - 1) / np.ptp(grid)
    sos = signal.butter(4, min(BAND * record.frequency_hz, 0.4 * rate), fs=rate, output="sos")
    smooth = signal.sosfiltfilt(sos, np.interp(grid, record.time_s, record.displacement_mm))
    return interpolate.CubicSpline(grid, smooth)(record.time_s, 2) * 1e-3


def _friction(record: Record, values: dict[str, float]) -> np.ndarray:
    spring = values["kp_N_mm"] * (record.displacement_mm - record.displacement_mm.mean())
    return record.force_N - spring - record.force_N.mean()


def changed(record: Record, effect: str, strength: float, values: dict[str, float]) -> Record:
    """The record with an effect in its signals; strength in the effect's unit (s, Hz, kg, N/s, share of friction)."""
    t, force = record.time_s, record.force_N
    if effect == "channel_delay":
        return replace(record, force_N=np.interp(t - strength, t, force))
    if effect == "force_highpass":
        return replace(record, force_N=force - _lowpass(force, record, strength))
    if effect == "integration_highpass":
        u = record.displacement_mm
        return replace(record, displacement_mm=u - _lowpass(u, record, strength))
    if effect == "moving_mass":
        return replace(record, force_N=force + strength * _acceleration_m_s2(record))
    if effect == "force_drift":
        return replace(record, force_N=force + strength * (t - t[0]))
    if effect == "friction_fade":
        gone = -np.expm1(-(t - t[0]) * record.frequency_hz / max(0.25 * np.ptp(t) * record.frequency_hz, 2.0))
        return replace(record, force_N=force - strength * gone * _friction(record, values))
    raise ValueError(f"no effect {effect!r} to put into a record; there are: {', '.join(EFFECTS)}")


EFFECTS = ("channel_delay", "force_highpass", "integration_highpass", "moving_mass", "force_drift", "friction_fade")


def size(tests: tuple[Record, ...], effect: str, strength: float, values: dict[str, float]) -> float:
    """RMS change of the force, without its constant part, over RMS friction force, all tests together. A displacement
    that is high-passed turns the loops as a force does that is, so it is sized as that."""
    kind = "force_highpass" if effect == "integration_highpass" else effect
    moved = friction = 0.0
    for x in tests:
        change = changed(x, kind, strength, values).force_N - x.force_N
        moved += float(np.var(change))
        friction += float(np.mean(_friction(x, values) ** 2))
    return float(np.sqrt(moved / friction))


def strength_for(tests: tuple[Record, ...], effect: str, wanted: float, values: dict[str, float]) -> float:
    """The strength of the size wanted, by bisection of its logarithm."""
    slowest, fastest = min(x.frequency_hz for x in tests), max(x.frequency_hz for x in tests)
    middle = {
        "channel_delay": 0.02 / fastest,
        "force_highpass": 0.1 * slowest,
        "integration_highpass": 0.1 * slowest,
        "friction_fade": 0.3,
    }.get(effect)
    if middle is None:
        middle = 0.1 / size(tests, effect, 1.0, values)
    low, high = np.log(middle) - 7.0, np.log(middle) + 5.0
    for _ in range(30):
        at = 0.5 * (low + high)
        low, high = (at, high) if size(tests, effect, float(np.exp(at)), values) < wanted else (low, at)
    return float(np.exp(low))


def _source(data: Path, name: str) -> Campaign:
    folder, only = SOURCES[name]
    campaign = read_campaign(data / folder)
    return campaign if only is None else replace(campaign, tests=tuple(x for x in campaign.tests if x.file == only))


def natural(data: Path, name: str) -> dict[str, Any]:
    """The search of a real campaign as it is: what was known of it before anything was added."""
    loops = _source(data, name).loops(**LOOPS)
    found = search(gap_data(loops), scales_of(loops), {}, catalogue.variants(), np.random.default_rng(0))
    before = on_top.known(found)
    verdict = on_top.attribute(Table.of(found))
    return {
        "name": name,
        "known": before,
        "cause": verdict.cause,
        "second": verdict.second_cause,
        "tests": len(loops),
        "held": [k.name for k, _ in before.effects],
    }


def one_case(
    data: Path, before: on_top.Known, name: str, effect: str, wanted: float, sign: float, by_size: bool
) -> dict[str, Any]:
    """Add one effect of one size to one campaign and look for it."""
    began = time.process_time()
    campaign = _source(data, name)
    values = dict(before.values)
    strength = sign * strength_for(campaign.tests, effect, wanted, values)
    new = replace(campaign, tests=tuple(changed(x, effect, strength, values) for x in campaign.tests))
    loops = new.loops(**LOOPS)
    data = gap_data(loops) if by_size else on_top.data_on_top(loops, before)
    a = on_top.attribute_on_top(on_top.search_on_top(data, before, catalogue.variants(), by_size), before, by_size)
    causes = sorted((n for n in a.probabilities if n not in ("none", "unknown")), key=lambda n: -a.probabilities[n])
    return {
        "campaign": name,
        "effect": effect,
        "size": wanted,
        "strength": strength,
        "answer": a.cause,
        "probability": a.probability,
        "set": list(a.cannot_tell_apart),
        "ranked": causes[:4],
        "right": a.cause == effect,
        "in_set": effect == a.cause or effect in a.cannot_tell_apart,
        "weights": {"+".join(k) or "none": v for k, v in sorted(a.hypotheses.items(), key=lambda kv: -kv[1])[:6]},
        "cpu_s": time.process_time() - began,
    }


def plan(n: int, seed: int, names: list[str]) -> list[tuple[str, str, float, float]]:
    """Campaign, effect, size and sign of n cases: campaigns and effects in turn, sizes log-uniform.

    A mass goes only into campaigns of several frequencies: at one frequency it is a spring, exactly.
    """
    rng = np.random.default_rng(seed)
    grid = [(c, e) for c in names for e in EFFECTS if e != "moving_mass" or SOURCES[c][0].startswith("mr_")]
    turns = [grid[i] for _ in range(-(-n // len(grid))) for i in rng.permutation(len(grid))][:n]
    signed = ("channel_delay", "force_drift")
    sizes = np.random.default_rng([seed, 1]).uniform(*np.log(SIZES), n)  # a longer plan begins as a shorter one
    signs = np.random.default_rng([seed, 2]).choice([-1.0, 1.0], n)
    return [(c, e, float(np.exp(x)), float(s) if e in signed else 1.0) for (c, e), x, s in zip(turns, sizes, signs)]


def figure(cases: list[dict[str, Any]], names: list[str]) -> Figure:
    """Every case by campaign and effect: right, in the set, or what was said instead."""
    fig = Figure(figsize=(9.5, 0.75 * len(names) + 1.8), layout="constrained")
    ax = fig.add_subplot()
    colours = {"right": "#2266aa", "in the set": "#88b0dd", "missed": "#cc6611"}
    for i, name in enumerate(names):
        for j, effect in enumerate(EFFECTS):
            here = [c for c in cases if c["campaign"] == name and c["effect"] == effect]
            for k, c in enumerate(here):
                kind = "right" if c["right"] else "in the set" if c["in_set"] else "missed"
                y = i + 0.3 * ((k + 0.5) / len(here) - 0.5) * 2
                ax.plot([j - 0.38], [y], "o", color=colours[kind], ms=3 + 35 * c["size"])
                said = "" if c["right"] else c["answer"].replace("_", " ")
                text = textwrap.fill(f"{100 * c['size']:.0f} % {said}", 20)
                ax.text(j - 0.28, y, text, fontsize=6.5, va="center", linespacing=1.25)
    for kind, colour in colours.items():
        ax.plot([], [], "o", color=colour, label=kind)
    ax.set_xticks(range(len(EFFECTS)), [e.replace("_", " ") for e in EFFECTS], fontsize=8)
    ax.set_yticks(range(len(names)), names, fontsize=8)
    ax.set_xlim(-0.55, len(EFFECTS) - 0.3)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set_xlabel("effect put in; size over friction force, and what was named instead")
    ax.legend(ncols=3, fontsize=8, frameon=False, loc="lower right", bbox_to_anchor=(1, 1))
    return fig


def slug(name: str) -> str:
    return "".join(x if x.isalnum() else "_" for x in name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="folder of the real campaigns")
    parser.add_argument("--out", type=Path, default=Path("half_real"))
    parser.add_argument("--cases", type=int, default=48)
    parser.add_argument("--know", choices=("loops", "size"), default="loops", help="what is known of the misfit")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sources", nargs="+", choices=list(SOURCES), default=list(SOURCES), metavar="NAME")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    args = parser.parse_args()
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")  # of the workers: they share the machine by cases
    args.out.mkdir(parents=True, exist_ok=True)
    found = {name: natural(args.data, name) for name in tqdm(args.sources, desc="as they are", disable=None)}
    for name, x in found.items():
        print(
            f"{name:16s} {x['tests']} tests; natural gap: {x['cause']}{' + ' + x['second'] if x['second'] else ''}; "
            f"held: {' + '.join(x['held']) or 'nothing'}; misfit left {100 * x['known'].share:.2f} % of friction",
            flush=True,
        )
    jobs = []
    for i, (c, *rest) in enumerate(plan(args.cases, args.seed, list(args.sources))):
        file = args.out / f"{args.know}_{args.seed}_{i:03d}_{slug(c)}_{rest[0]}.json"
        jobs.append((file, one_case, args.data, found[c]["known"], c, *rest, args.know == "size"))
    cases: list[dict[str, Any]] = []
    for c in each(jobs, args.workers, "cases"):
        cases.append(c)
        print(
            f"{c['campaign']:16s} {c['effect']:21s} {100 * c['size']:4.1f} %  -> {c['answer']} "
            f"({c['probability']:.2f}) set: {', '.join(c['set'])}",
            flush=True,
        )
    rng = np.random.default_rng(0)
    several = [c for c in cases if found[c["campaign"]]["tests"] > 1]
    summary = {
        "right or in the set": share([c["in_set"] for c in cases]),
        "right": share([c["right"] for c in cases]),
        "right or in the set, several frequencies": share([c["in_set"] for c in several]),
        "likeliest of the causes": share([c["effect"] == c["ranked"][0] for c in cases]),
        "among the three likeliest causes": share([c["effect"] in c["ranked"][:3] for c in cases]),
        "called none": share([c["answer"] == "none" for c in cases]),
        "called unknown": share([c["answer"] == "unknown" for c in cases]),
        "causes in the set": bootstrap([max(len(c["set"]), 1) for c in cases], rng),
    }
    for e in EFFECTS:
        summary[f"{e}: right or in the set"] = share([c["in_set"] for c in cases if c["effect"] == e])
    for text, value in summary.items():
        print(f"{text:45s} {value.text()}")
    before = [{k: v for k, v in x.items() if k != "known"} | {"share": x["known"].share} for x in found.values()]
    write_json(
        args.out / f"half_real_{args.know}.json",
        {
            "seed": args.seed,
            "know": args.know,
            "summary": {k: vars(v) for k, v in summary.items()},
            "cases": cases,
            "natural": before,
        },
    )
    figure(cases, list(args.sources)).savefig(args.out / f"half_real_{args.know}.png", dpi=130)
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
