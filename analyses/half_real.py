"""Half-real cases: known effects put into real recordings, to be found beside the gap that these have anyway.

    python analyses/half_real.py --data ../shared/data --out runs/half_real [--cases 48] [--workers 2]

Each real campaign is diagnosed as it is. Then a delay, a high-pass of force or displacement, a mass, a drift or a fade
of friction is applied to the measured signals at a size of 6 to 20 % of the friction force, the loops are averaged
anew, and the campaign is diagnosed again, with nothing told of the first diagnosis. Right is an answer that names what
was added (or has it among what cannot be distinguished from a named cause); where the natural gap already had a part
with that name, its strength must have moved by two standard deviations (counted without that, too). The natural budget
should be unchanged: each natural cause still named, or in a set, and its newtons what they were, within the interval
that was said or ten points of the natural gap; a cause that is lost has none. An effect can be absorbed by the model's
own parameters, or undo a part of the natural gap: what is found is also counted over the visible ones, which make the
gap that the model leaves, or its part along the record, larger.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import interpolate, signal

from bayes_iwan.campaign import Record, read_campaign
from bayes_iwan.diagnosis.answer.diagnosis_json import to_dict
from bayes_iwan.diagnosis.answer.saved_fits import loops_of
from bayes_iwan.diagnosis.diagnosis import diagnose_loops
from bayes_iwan.executors import Failure, finished
from bayes_iwan.files import write_json
from bayes_iwan.withheld.estimates import share

#: campaign folders
SOURCES = {
    "microtribometer": "microtribometer",
    "damper, 0 A": "mr_damper_off",
    "damper, 0.5 A": "mr_damper_half",
    "seal, 1 to 7 bar": "pneumatic_seal",
}
#: what is not put into a source: a mass that would weigh tons at its frequencies, or be a spring at its one; a fade of
#: the loop's width where most of it is microslip, since there less friction makes loops wider
NOT_THERE = {"microtribometer": ("moving_mass", "friction_fade"), "seal, 1 to 7 bar": ("moving_mass",)}
SIZES = (0.06, 0.20)
#: harmonics of the displacement from which a mass's acceleration is taken, as many as loops are averaged with
BAND = 24.0
#: an effect whose force changed by so many standard deviations has another strength
MOVED = 2.0
#: an effect is visible if a gap is larger by this share with it, and undoes a part of it if it is smaller by as much
VISIBLE = 0.1
#: a natural cause's share of the natural gap is unchanged within so much
UNCHANGED = 0.1
#: alternatives of a natural place within so many nats may be what is there


def _lowpass(values: np.ndarray, record: Record, corner_hz: float) -> np.ndarray:
    """First-order low-pass of a channel that has settled long before the record began, any time steps."""
    time_s = record.time_s - record.time_s[0]
    grid = np.linspace(0.0, time_s[-1], 2 * len(time_s))
    a = -np.expm1(-2.0 * np.pi * corner_hz * grid[1])
    filtered, _ = signal.lfilter([a], [1.0, a - 1.0], np.interp(grid, time_s, values), zi=[(1.0 - a) * values.mean()])
    # the state at the start is whatever leaves no decaying part beside the cycles
    decay, turn = np.exp(-2.0 * np.pi * corner_hz * grid), 2.0 * np.pi * record.frequency_hz * grid
    waves = [g(h * turn) for h in (1, 2, 3) for g in (np.cos, np.sin)]
    part = np.linalg.lstsq(np.stack([decay, np.ones_like(grid), *waves], axis=1), filtered, rcond=None)[0]
    return np.interp(time_s, grid, filtered - part[0] * decay)


def _acceleration_m_s2(record: Record) -> np.ndarray:
    """Second derivative of the displacement's first harmonics."""
    grid = np.linspace(record.time_s[0], record.time_s[-1], len(record.time_s))
    rate = (len(grid) - 1) / np.ptp(grid)
    sos = signal.butter(4, min(BAND * record.frequency_hz, 0.4 * rate), fs=rate, output="sos")
    smooth = signal.sosfiltfilt(sos, np.interp(grid, record.time_s, record.displacement_mm))
    return interpolate.CubicSpline(grid, smooth)(record.time_s, 2) * 1e-3


def _friction(record: Record) -> np.ndarray:
    """Force about its mean less its best elastic part: friction as far as a record alone shows it."""
    u, f = record.displacement_mm - record.displacement_mm.mean(), record.force_N - record.force_N.mean()
    return f - u * float(u @ f) / float(u @ u)


def changed(record: Record, effect: str, strength: float) -> Record:
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
        return replace(record, force_N=force - strength * gone * _friction(record))
    raise ValueError(f"no effect {effect!r} to put into a record; there are: {', '.join(EFFECTS)}")


EFFECTS = ("channel_delay", "force_highpass", "integration_highpass", "moving_mass", "force_drift", "friction_fade")


def size(tests: tuple[Record, ...], effect: str, strength: float) -> float:
    """RMS change of the force, without its constant part, over RMS friction force, all tests together. A displacement
    that is high-passed turns the loops as a force does that is, so it is sized as that."""
    kind = "force_highpass" if effect == "integration_highpass" else effect
    moved = sum(float(np.var(changed(x, kind, strength).force_N - x.force_N)) for x in tests)
    return float(np.sqrt(moved / sum(float(np.mean(_friction(x) ** 2)) for x in tests)))


def strength_for(tests: tuple[Record, ...], effect: str, wanted: float) -> float:
    """The strength of the size wanted, by bisection of its logarithm."""
    low, high = np.log(1e-9), np.log(1e9)
    for _ in range(60):
        middle = 0.5 * (low + high)
        with np.errstate(all="ignore"):
            found = size(tests, effect, float(np.exp(middle)))
        low, high = (middle, high) if found < wanted else (low, middle)
    return float(np.exp(0.5 * (low + high)))


def answered(data: Path, case: tuple[str, str, float]) -> dict[str, Any]:
    """The diagnosis of a source with an effect of a size in it ("" and 0: as it is)."""
    source, effect, wanted = case
    campaign = read_campaign(data / SOURCES[source])
    strength = strength_for(campaign.tests, effect, wanted) if effect else 0.0
    if effect:
        campaign = replace(campaign, tests=tuple(changed(t, effect, strength) for t in campaign.tests))
    found = diagnose_loops(campaign, loops_of(campaign), quick=True)
    d = to_dict(found)
    return (
        {"source": source, "effect": effect, "size": wanted, "strength": strength}
        | {"figures": [asdict(f) for f in found.found.figures]}  # from which constants are fitted: `places`
        | {k: d[k] for k in ("verdict", "effects", "probabilities", "gap", "unexplained", "sentences")}
    )


def visible(answer: dict[str, Any], natural: dict[str, Any]) -> bool:
    """Does the added effect make the gap, or its part along the record, clearly larger?"""
    parts = ("before_rms_N", "along_record_rms_N")
    return any(answer["gap"][k] > (1.0 + VISIBLE) * natural["gap"][k] for k in parts)


def assessed(answer: dict[str, Any], natural: dict[str, Any]) -> dict[str, bool]:
    """Is the added effect named (or in the set), and are the natural causes still there?"""
    causes = {c["name"]: c for c in answer["verdict"]["causes"]}
    before = {e["name"]: e for e in natural["effects"]}
    name = answer["effect"]
    named = name in causes
    if named and name in before:  # it was there before: it must move another force
        (a, a_sd), (b, b_sd) = (_moves(e) for e in (before[name], _effect(answer, name)))
        named = abs(a - b) > MOVED * float(np.hypot(a_sd, b_sd))
    together = _tied(answer)
    near = named or name in together
    suspected = near or name in {x["name"] for x in answer["verdict"]["suspects"]}
    kept = set(before) <= set(causes) | set(together)
    found = {
        "named, or named as before": name in causes,
        "named": named,
        "named or in the set": near,
        "named, in the set or suspected": suspected,
    }
    counted = {f"{k}, visible ones": v for k, v in found.items() if visible(answer, natural)}
    return found | counted | {"natural causes still named": kept}


def _tied(answer: dict[str, Any]) -> dict[str, float]:
    """Effects that stand in a set, or that a named cause cannot be told from, and the share of the gap of that."""
    tied = {n: c["share"] for c in answer["verdict"]["causes"] for n in c["tied_with"]}
    return tied | {n: some["share"] for some in answer["verdict"]["one_of"] for n in some["names"]}


def undone(answer: dict[str, Any], natural: dict[str, Any]) -> bool:
    """Does the added effect undo a part of the natural gap, so that its budget cannot be what it was?"""
    return answer["gap"]["before_rms_N"] < (1.0 - VISIBLE) * natural["gap"]["before_rms_N"]


def budget_kept(answer: dict[str, Any], natural: dict[str, Any]) -> list[dict[str, bool]]:
    """Of every natural cause: is it still named, or in a set, and is its part of the natural gap what it was?"""
    scale = answer["gap"]["before_rms_N"] / natural["gap"]["before_rms_N"]
    named = {c["name"]: c["share"] for c in answer["verdict"]["causes"]}
    tied = _tied(answer)
    out = []
    for cause in natural["verdict"]["causes"]:
        name, (low, high) = cause["name"], cause["share_interval"]
        there = name in named or name in tied
        now = scale * named.get(name, tied.get(name, 0.0))
        same = abs(now - cause["share"]) <= UNCHANGED or (there and low <= now <= high)
        out.append({"named": name in named, "named or in a set": there, "newtons unchanged": same})
    return out


def _moves(effect: dict[str, Any]) -> tuple[float, float]:
    """RMS force that an effect moves over the friction force, and its sd, in proportion to that of its strength: what a
    strength means hangs on the law's other numbers, which a second effect of the same name changes."""
    strength, moved = next(iter(effect["parameters"].values())), float(effect["moved_share"])
    return moved, moved * strength["sd"] / max(abs(strength["mean"]), 1e-300)


def _effect(answer: dict[str, Any], name: str) -> dict[str, Any]:
    return next(e for e in answer["effects"] if e["name"] == name)


def plan(cases: int, seed: int) -> list[tuple[str, str, float]]:
    """Source, effect and size of each case."""
    rng = np.random.default_rng(seed)
    out = []
    for i in range(cases):
        source = list(SOURCES)[i % len(SOURCES)]
        some = [e for e in EFFECTS if e not in NOT_THERE.get(source, ())]
        out.append((source, str(rng.choice(some)), float(np.exp(rng.uniform(*np.log(SIZES))))))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--out", type=Path, default=Path("runs/half_real"))
    parser.add_argument("--cases", type=int, default=48)
    parser.add_argument("--seed", type=int, default=20261122)
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    pieces: dict[str, tuple[str, str, float]] = {f"natural, {s}": (s, "", 0.0) for s in SOURCES}
    pieces |= {f"{args.seed}/{i:03d}": case for i, case in enumerate(plan(args.cases, args.seed))}
    store = args.out / "answers.json"
    done: dict[str, Any] = json.loads(store.read_text()) if store.is_file() else {}
    left = {k: v for k, v in pieces.items() if k not in done}
    for name, result in finished(left, answered, args.data, workers=args.workers, what="half-real", unit="case"):
        if isinstance(result, Failure):
            print(f"{name}: {result}")
        else:
            done[name] = result
            write_json(store, done)  # a killed run goes on from here
    for source in SOURCES:
        print(f"{source}: " + " ".join(done[f"natural, {source}"]["sentences"][:4]))
    found = [assessed(a, done[f"natural, {a['source']}"]) for k, a in done.items() if not k.startswith("natural")]
    for source in SOURCES:
        its = [a for k, a in done.items() if a["source"] == source and not k.startswith("natural")]
        named = [assessed(a, natural)["named"] for a in its if visible(a, natural := done[f"natural, {source}"])]
        print(f"{source}: named {sum(named)} of {len(named)} visible ones")
    beside = [(a, done[f"natural, {a['source']}"]) for k, a in done.items() if not k.startswith("natural")]
    of_each = [budget_kept(*pair) for pair in beside]
    kept = [k for some in of_each for k in some]
    for source in SOURCES:
        its = [k for (a, _), some in zip(beside, of_each) if a["source"] == source for k in some]
        told = ", ".join(f"{w} {sum(k[w] for k in its)} of {len(its)}" for w in (its[0] if its else ()))
        print(f"{source}, natural causes: {told or 'none'}")
    for what in kept[0] if kept else ():
        print(f"natural causes {what}: {share([k[what] for k in kept]).text()}")
        there = [k[what] for (a, natural), some in zip(beside, of_each) for k in some if not undone(a, natural)]
        print(f"natural causes {what}, where the addition undoes no part of the gap: {share(there).text()}")
    for what in dict.fromkeys(w for f in found for w in f):
        print(f"{what}: {share([f[what] for f in found if what in f]).text()}")


if __name__ == "__main__":
    main()
