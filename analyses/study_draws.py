"""Draw the campaigns of a study of the diagnosis and keep them: records and truth, one pickle a case.

    python analyses/study_draws.py --out /work/cache/draws --seed 4101 [--times 1] [--workers 2]

Kinds: nothing wrong, the package's own model at large amplitude, one to three effects of the catalogue by laws that it
does not have, each foreign kind alone and beside a known effect, and the record of a single test. Every kind of case
and every foreign kind is drawn in turn, so that the first N cases are as mixed as all.
"""

from __future__ import annotations

import argparse
import pickle
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

import bayes_iwan as bi
from bayes_iwan.arrays import ParameterValues
from bayes_iwan.campaign import Record
from bayes_iwan.executors import Failure, finished
from bayes_iwan.files import write_whole
from bayes_iwan.models.paper_parameters import table_1
from bayes_iwan.virtual_rig import cases as rig_cases
from bayes_iwan.virtual_rig.faults import CATALOGUE, FAMILY, OUTSIDE

#: kind of case and how many of it there are in one round of 22 foreign kinds
ROUND = {
    "single": 22,
    "pair": 12,
    "triple": 6,
    "outside": 22,
    "known_beside_outside": 14,
    "none": 10,
    "own_model": 8,
    "one_record_single": 6,
    "one_record_outside": 6,
}
#: kinds whose displacement amplitude is a few times the paper's
LARGE_MM = (1.0, 6.0)


def plan(seed: int, times: int) -> list[tuple[str, str | None]]:
    """Kind and foreign fault of each case, mixed."""
    rng = np.random.default_rng([seed, 0])
    out: list[tuple[str, str | None]] = []
    for _ in range(times):
        foreign = {k: iter(np.resize(rng.permutation(OUTSIDE), n)) for k, n in ROUND.items() if "outside" in k}
        kinds = [k for k, n in ROUND.items() for _ in range(n)]
        out += [(k, str(next(foreign[k])) if k in foreign else None) for k in rng.permutation(kinds).tolist()]
    return out


def own_model(rng: np.random.Generator) -> dict[str, Any]:
    """The package's own model, Table 1 of the paper, at large amplitudes, with noise on the force."""
    reference = bi.Scales(1.0, 0.063, 10.0, 1.2, 6.0, 14.0).reference
    largest = float(np.exp(rng.uniform(*np.log(LARGE_MM))))
    amplitudes = np.round(largest * np.array([0.4, 1.0])[: int(rng.integers(1, 3))], 2)
    records = records_of(bi.Model(reference), table_1(reference), amplitudes, rng)
    return {"records": records, "truth": {"kind": "none", "effects": [], "friction_rms_N": float("nan")}}


def records_of(
    model: bi.Model, values: ParameterValues, amplitudes_mm: Iterable[float], rng: np.random.Generator
) -> list[Record]:
    """A model's loops at two or three frequencies, with the noise of sensors."""
    frequencies = np.round(float(rng.uniform(5, 12)) * np.array([1.0, 1.5, 2.5])[: int(rng.integers(2, 4))], 1)
    noise = float(np.exp(rng.uniform(*np.log(rig_cases.NOISE_RANGE))))
    records, n, cycles = [], 256, 20
    for a in amplitudes_mm:
        for f in frequencies:
            motion = bi.sine_motion(frequency_hz=f, amplitude_mm=a, samples=n)
            force, u = (np.tile(x, cycles) for x in (model.force(values, motion)[0, 0], motion.displacement_mm[0, 0]))
            u = u + 1e-4 * a * rng.standard_normal(u.size)
            force = force + noise * force.std() * rng.standard_normal(u.size)
            time_s = np.arange(u.size) / (n * f)
            records.append(Record(file=f"f{f:g}_a{a:g}.csv", frequency_hz=float(f), amplitude_mm=float(a), role="fit",
                                  extras={}, time_s=time_s, displacement_mm=u, force_N=force, warnings=()))  # fmt: skip
    return records


def drawn(shared: dict[str, Any], piece: tuple[int, str, str | None]) -> bytes:
    """One case, pickled."""
    index, kind, foreign = piece
    rng = np.random.default_rng([shared["seed"], 1, index])
    if kind == "own_model":
        out = own_model(rng)
    else:
        rig_kind = kind.removeprefix("one_record_")
        names = [foreign] if foreign else None
        while kind == "known_beside_outside" and len(names or ()) < 2:
            known = str(rng.choice(CATALOGUE))
            if frozenset({known, foreign}) not in rig_cases._NOT_TOGETHER:
                names = [known, str(foreign)]
        case = rig_cases.draw_case(rng, rig_kind, names, laws="other")
        given, _ = rig_cases.simulate(case)
        records = [r for r in given if r.role != "held-out"]
        if kind.startswith("one_record"):
            records = sorted(records, key=lambda r: (r.amplitude_mm, r.frequency_hz))[-1:]
        out = {"records": records, "truth": case.truth(f"{shared['seed']}/{index}")}
    return pickle.dumps(out | {"kind": kind, "foreign": foreign, "family": FAMILY.get(foreign or "", "")})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--times", type=int, default=1, help="rounds")
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    paths = {args.out / f"{args.seed}_{i:04d}.pickle": (i, *x) for i, x in enumerate(plan(args.seed, args.times))}
    pieces = {str(path): piece for path, piece in paths.items() if not path.is_file()}
    for path, result in finished(pieces, drawn, {"seed": args.seed}, workers=args.workers, what="draws", unit="case"):
        print(f"{path}: {result}") if isinstance(result, Failure) else write_whole(path, result)


if __name__ == "__main__":
    main()
