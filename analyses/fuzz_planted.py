"""A known signal in every form, changed as programs, recorders and people change files: is its number silently wrong?

    python analyses/fuzz_planted.py --inputs 10000 [--seed N] [--only lvm ...] [--show]

The energy of a cycle and the frequency of the signal are known. A table of it is changed in one to three ways: written
otherwise (units, marks, codings, foreign columns, other order), or recorded worse (range passed, held, late by its own
start, rows lost or repeated, a counter that rolls over, bytes of the body changed, and the faults of mutations.py).
What `import` makes of the file is *refused* (one line), *asked*, *said* (a warning), *right* (energy within 1 % and
frequency within 2 % without a word), or *silent*, which must not be; *traceback* and *hang* neither. A changed unit or
name that could stand there as well is not tried: nobody could see it.
"""

from __future__ import annotations

import argparse
import datetime
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import mutations
from bayes_iwan.campaign import CampaignError, Record
from bayes_iwan.campaign.importing import ImportAsks, Recipe, import_tests
from fuzz_campaigns import Hang, limited
from planted_forms import FORMS, WEIGHTS, Column, Table, known_signal

Rng = np.random.Generator
WRONG, WRONG_FREQUENCY = 0.01, 0.02
OUTCOMES = ("refused", "asked", "said", "right", "silent", "traceback", "hang")
#: what single records cannot show
FAULTS = mutations.SEEN[:-3]


def other_units(table: Table, rng: Rng) -> Table:
    motion, force, clock = (
        list(x)[rng.integers(len(x))]
        for x in (
            (("m", 1e-3), ("µm", 1e3), ("in", 1 / 25.4), ("cm", 0.1), ("MM", 1.0)),
            (("kN", 1e-3), ("lbf", 1 / 4.4482216152605), ("daN", 0.1), ("KN", 1e-3), ("kgf", 1 / 9.80665)),
            (("ms", 1e3), ("us", 1e6), ("min", 1 / 60), ("SEC", 1.0)),
        )
    )
    table = table.column(0, unit=motion[0], values=table.get(0).values * motion[1])
    table = table.column(1, unit=force[0], values=table.get(1).values * force[1])
    return replace(table, how={**table.how, "time unit": clock})


def foreign_columns(table: Table, rng: Rng) -> Table:
    n = table.time_s.size
    speed = np.gradient(table.get(0).values, table.time_s)
    some = [
        Column("Temperature", "°C", 20 + 0.01 * rng.standard_normal(n)),
        Column("Velocity", "mm/s", speed),
        Column("Dehnung", "mm/mm", table.get(0).values / 50),
        Column("Spannung", "V", rng.standard_normal(n)),
        Column("Cycle", "", np.floor(table.time_s * table.frequency_hz)),
        Column("Status", "", np.ones(n)),
        Column("Beschleunigung", "g", rng.standard_normal(n)),
    ]
    more = [c for c in some if rng.random() < 0.4]
    columns = [*table.columns, *more]
    return replace(table, columns=tuple(columns[k] for k in rng.permutation(len(columns))))


def other_marks(table: Table, rng: Rng) -> Table:
    separator = str(rng.choice([";", "\t", "|", ","]))
    how = {
        "separator": separator, "decimal": str(rng.choice([".", ","])), "thousands": bool(rng.random() < 0.3),
        "quoted": bool(rng.random() < 0.3), "end": str(rng.choice(["\n", "\r\n"])),
        "encoding": str(rng.choice(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252", "gb18030"])),
        "units": str(rng.choice(["brackets", "row", "above"])),
    }  # fmt: skip
    return replace(table, how={**table.how, **how})


def preamble(table: Table, rng: Rng) -> Table:
    lines = ["Rig 3, operator X", f"Date: {datetime.date(2024, 3, 1)}", f"Sample rate: {table.rate_hz:g} Hz"]
    return replace(table, how={**table.how, "above": lines[: int(rng.integers(1, 4))]})


def stamps(table: Table, rng: Rng) -> Table:
    kind = str(rng.choice(["%H:%M:%S.%f", "%I:%M:%S.%f %p", "%Y-%m-%d %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f", "us"]))
    before = float(rng.uniform(0, 1.5)) * float(np.ptp(table.time_s))
    return replace(table, how={**table.how, "stamps": (kind, before)})


def rounded_time(table: Table, rng: Rng) -> Table:
    """Times rounded to some digits, beside a stated rate."""
    digits = int(rng.integers(1, 4))
    lines = ["Rig 3", f"Sample rate: {table.rate_hz:g} Hz"]
    return replace(table, time_s=np.round(table.time_s, digits), how={**table.how, "above": lines})


def no_time(table: Table, rng: Rng) -> Table:
    above = [f"Sample rate: {table.rate_hz:g} Hz"] if rng.random() < 0.7 else ["Rig 3"]
    return replace(table, how={**table.how, "above": above, "no time": True})


def late(table: Table, rng: Rng) -> Table:
    """The force began later, as its own times say."""
    k = int(rng.integers(1, 12))
    one = table.get(1)
    n = table.time_s.size - k
    shifted = replace(one, values=one.values[k:], times_s=table.time_s[k:])
    table = table.rows(np.arange(n))
    return table.column(1, values=shifted.values, times_s=shifted.times_s)


def overrange(table: Table, rng: Rng) -> Table:
    k = int(rng.integers(2))
    one = table.get(k)
    limit = float(rng.uniform(0.7, 0.98)) * np.abs(one.values).max()
    code = float(rng.choice([9.91e37, 9.9e37, np.inf, 999999.0]))
    return table.column(k, values=np.where(np.abs(one.values) > limit, np.sign(one.values) * code, one.values))


def gaps(table: Table, rng: Rng) -> Table:
    k = int(rng.integers(2))
    one = table.get(k)
    values = one.values.copy()
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(values.size))
        values[at : at + int(rng.integers(1, 30))] = np.nan
    return table.column(k, values=values)


def held(table: Table, rng: Rng) -> Table:
    k, times = int(rng.integers(2)), int(rng.integers(2, 9))
    one = table.get(k)
    start = int(rng.integers(times))
    index = np.maximum((np.arange(one.values.size) + start) // times * times - start, 0)
    return table.column(k, values=one.values[index])


def coarse(table: Table, rng: Rng) -> Table:
    k, levels = int(rng.integers(2)), int(rng.integers(6, 300))
    one = table.get(k)
    step = np.nanmax(np.abs(one.values[np.isfinite(one.values)])) * 2 / levels
    return table.column(k, values=np.round(one.values / step) * step)


def drift(table: Table, rng: Rng) -> Table:
    k = int(rng.integers(2))
    one = table.get(k)
    size = np.nanmax(np.abs(one.values[np.isfinite(one.values)])) * rng.uniform(0.2, 6)
    return table.column(k, values=one.values + size * np.linspace(0, 1, one.values.size))


def mean_moved(table: Table, rng: Rng) -> Table:
    k = int(rng.integers(2))
    one = table.get(k)
    return table.column(k, values=one.values + np.nanstd(one.values) * rng.uniform(-20, 20))


def rows_repeated(table: Table, rng: Rng) -> Table:
    a = int(rng.integers(table.time_s.size - 20))
    n = int(rng.integers(1, 20))
    return table.rows(np.concatenate([np.arange(a + n), np.arange(a, table.time_s.size)]))


def rows_swapped(table: Table, rng: Rng) -> Table:
    index = np.arange(table.time_s.size)
    i, j = rng.integers(0, index.size, 2)
    index[i], index[j] = index[j], index[i]
    return table.rows(index)


def run_appended(table: Table, rng: Rng) -> Table:
    n = table.time_s.size
    return table.rows(np.concatenate([np.arange(n), np.arange(n)]))


def runs_glued(table: Table, rng: Rng) -> Table:
    """Two pieces of one test, one behind the other, the clock counted on."""
    n = table.time_s.size
    a, b = sorted(rng.integers(n // 4, 3 * n // 4, 2))
    return table.rows(np.concatenate([np.arange(b), np.arange(a, n)])[:n], renumbered=True)


def record_fault(table: Table, rng: Rng) -> Table:
    fault = FAULTS[rng.integers(len(FAULTS))]
    if not np.median(np.diff(table.time_s)) > 0:
        return table  # rounded to more than a step
    a, b = table.get(0), table.get(1)
    record = Record("a.csv", table.frequency_hz, 1.0, "fit", {}, table.time_s, a.values, b.values)
    with np.errstate(all="ignore"):
        found = fault(record, rng)
    table = replace(table, columns=(a, b), time_s=found.time_s)
    n = found.time_s.size
    table = table.column(0, values=found.displacement_mm[:n]).column(1, values=found.force_N[:n], times_s=None)
    return replace(table, how={**table.how, "fault": fault.__name__})


REWRITTEN = (other_units, foreign_columns, other_marks, preamble, stamps, rounded_time, no_time)
WORSE = (
    late, overrange, gaps, held, coarse, drift, mean_moved, rows_repeated, rows_swapped, run_appended, runs_glued,
    record_fault,
)  # fmt: skip


def body_damaged(path: Path, rng: Rng) -> None:
    """Damage the bytes behind the head, as a cable, a disk or an editor does."""
    one = path if path.is_file() else sorted(path.iterdir())[int(rng.integers(2))]
    raw = one.read_bytes()
    start = min(2000, len(raw) // 3)
    kinds = mutations.GENTLE[::2] if rng.random() < 0.5 else mutations.ROUGH[:5]
    one.write_bytes(raw[:start] + kinds[rng.integers(len(kinds))](raw[start:], rng))


@dataclass(frozen=True)
class Trial:
    """One planted signal: the form, the changes, what came of it, and the energy over the true one."""

    form: str
    changes: tuple[str, ...]
    outcome: str
    ratio: float
    words: str


def trial(seed: int, i: int, only: list[str] | None, folder: Path) -> Trial:
    rng = np.random.default_rng([seed, i])
    names = only or list(FORMS)
    weights = np.array([WEIGHTS[n] for n in names], dtype=float)
    form = names[int(rng.choice(len(names), p=weights / weights.sum()))]
    table = known_signal(rng)
    recipe = Recipe()
    if form == "wav":
        sizes = [4 * float(np.abs(table.get(k).values).max()) for k in (0, 1)]
        recipe = Recipe(
            channels={"displacement": "1", "force": "2"},
            units={"displacement": f"{sizes[0]!r} mm", "force": f"{sizes[1]!r} N"},
        )
        table = replace(table, how={"full scale": sizes})
    changes: list[str] = []
    for way in [REWRITTEN[k] for k in rng.permutation(len(REWRITTEN))[: int(rng.integers(0, 3))]]:
        if form == "wav" or (form == "two files" and way is not preamble):
            continue
        if way in (stamps, no_time, rounded_time) and form not in ("text", "excel"):
            continue
        if {"stamps", "no time"} & set(table.how) and way in (stamps, no_time, rounded_time):
            continue
        table = way(table, rng)
        changes.append(way.__name__)
    if rng.random() < 0.8:
        way = WORSE[rng.integers(len(WORSE))]
        if not (way is late and (form == "wav" or {"stamps", "no time"} & set(table.how))):
            table = way(table, rng)
            changes.append(str(table.how.get("fault", way.__name__)))
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir()
    path = FORMS[form][1](folder / FORMS[form][0], table, rng)
    if rng.random() < 0.15:
        body_damaged(path, rng)
        changes.append("bytes")
    outcome, ratio, words = _judged(table, path, recipe)
    return Trial(form, tuple(changes), outcome, ratio, words)


def _judged(table: Table, path: Path, recipe: Recipe) -> tuple[str, float, str]:
    try:
        with limited():
            tests = import_tests([path], recipe)
    except ImportAsks as error:
        return "asked", np.nan, str(error)
    except CampaignError as error:
        return ("traceback" if "\n" in str(error) else "refused"), np.nan, str(error)
    except Hang:
        return "hang", np.nan, ""
    except Exception:
        return "traceback", np.nan, traceback.format_exc(limit=-3)
    worst, wrong = 1.0, False
    for test in tests:
        loop = test.loop
        energy = float(np.mean(loop.force_N * loop.velocity_m_s) / loop.frequency_hz * 1e3)
        ratio = energy / table.energy_Nmm
        if abs(ratio - 1) > abs(worst - 1):
            worst = ratio
        off = abs(ratio - 1) > WRONG or abs(loop.frequency_hz / table.frequency_hz - 1) > WRONG_FREQUENCY
        # what is said of every time without a unit says nothing of a fault
        wrong |= off and not [w for w in test.record.warnings if "is taken for s" not in w]
    if any(t.record.warnings for t in tests) and not wrong:
        return "said", worst, "; ".join(w for t in tests for w in t.record.warnings)
    return ("silent" if wrong else "right"), worst, ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--only", nargs="+", metavar="FORM", choices=list(FORMS))
    parser.add_argument(
        "--show", nargs="*", metavar="OUTCOME", choices=OUTCOMES, default=["silent", "traceback", "hang"]
    )
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    began = time.monotonic()
    by_form: dict[str, Counter[str]] = {}
    by_change: dict[str, Counter[str]] = {}
    scratch = Path(tempfile.mkdtemp(prefix="planted", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        for i in range(args.first, args.first + args.inputs):
            with np.errstate(all="ignore"):
                found = trial(args.seed, i, args.only, scratch / "one")
            by_form.setdefault(found.form, Counter())[found.outcome] += 1
            for change in found.changes or ("none",):
                by_change.setdefault(change, Counter())[found.outcome] += 1
            if found.outcome in args.show:
                what = f"{found.form}, {' + '.join(found.changes)}, {found.ratio:.4f} {found.words}"
                print(f"{found.outcome}: {args.seed} {i}: {what}", flush=True)
    finally:
        shutil.rmtree(scratch)
    for head, table in (("form", by_form), ("change", by_change)):
        print(f"{head:22s} " + " ".join(f"{h:>9s}" for h in OUTCOMES))
        for name, counts in sorted(table.items()):
            print(f"{name:22s} " + " ".join(f"{counts[h]:9d}" for h in OUTCOMES))
    total = sum(by_form.values(), Counter())
    print(f"{'all':22s} " + " ".join(f"{total[h]:9d}" for h in OUTCOMES))
    print(f"{sum(total.values())} inputs in {time.monotonic() - began:.0f} s")
    sys.exit(1 if any(total[x] for x in ("silent", "traceback", "hang")) else 0)


if __name__ == "__main__":
    main()
