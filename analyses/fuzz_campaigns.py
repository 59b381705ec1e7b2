"""Faulty records against `check`: refused, warned of, silent, traceback or hang, and the memory it took.

    python analyses/fuzz_campaigns.py [CAMPAIGN] [--faults N] [--seed N]

One record of the campaign is changed as recorders, cables, drives and people do. A change counts where it moves the
frequency, the amplitude, the mean or a harmonic of the loop by more than 2 % of the largest; of those the table says
how many had no word. Peak memory is that of this one process over all of them. Damaged bytes are in fuzz.py.
"""

from __future__ import annotations

import argparse
import contextlib
import resource
import signal
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from bayes_iwan.campaign import CampaignError, Loop, Record, average, read_campaign
from bayes_iwan.campaign.loops.between_tests import compared
from bayes_iwan.campaign.loops.checks import check_record, check_time, step_warnings

try:
    from analyses import mutations
except ModuleNotFoundError:  # run as a script
    import mutations

HERE = Path(__file__).parent
LIMIT_S = 10
CHANGED = 0.02


class Hang(BaseException):
    """A reader that took longer than LIMIT_S."""


@contextlib.contextmanager
def limited(seconds: int = LIMIT_S) -> Iterator[None]:
    """Raise Hang in this process after so many seconds of its own work."""

    def stop(*_: object) -> None:
        raise Hang

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def changed(base: Loop, record: Record) -> bool:
    """Whether averaging the mutated record as it stands gives another loop, or none."""
    try:
        loop = average(record, n_blocks=1)
    except (CampaignError, ArithmeticError, ValueError, np.linalg.LinAlgError):
        return True
    size = np.abs(base.harmonics_N).max()
    moved = np.abs(loop.harmonics_N[:10] - base.harmonics_N[:10]).max() / size
    return bool(
        moved > CHANGED
        or abs(loop.frequency_hz / base.frequency_hz - 1) > CHANGED
        or abs(loop.amplitude_mm / base.amplitude_mm - 1) > CHANGED
    )


def fuzz_faults(path: Path, n: int, seed: int, show: bool = False) -> dict[str, Counter[str]]:
    """Counts by fault: refused, warned, silent (loop changed, no word), harmless, and tracebacks."""
    with np.errstate(all="ignore"):
        records = [replace(r, warnings=()) for r in read_campaign(path).tests]
        sound = [check_record(r) for r in records]
    known = {w for r in compared([r for r, _ in sound], [p for _, p in sound]) for w in r.warnings}
    out: dict[str, Counter[str]] = {}
    for i in range(n):
        rng = np.random.default_rng([seed, i])
        name, k, record = mutations.one_fault(records, rng)
        counts = out.setdefault(name, Counter())
        try:
            with limited():
                check_time(record.file, record.time_s, None, record.frequency_hz)
                checked = check_record(replace(record, warnings=step_warnings(record.time_s)))
                others = [*sound[:k], checked, *sound[k + 1 :]]
                tests = compared([r for r, _ in others], [p for _, p in others])
            said = [w for t in tests for w in t.warnings if w not in known]
            result = "warned" if said else "silent" if changed(sound[k][1], record) else "harmless"
            if show and result == "silent":
                print(f"silent: {name}, test {record.file}, seed {seed} {i}")
        except CampaignError as error:
            result = "refused"
            if not str(error).isprintable():
                result = "message of several lines"
        except Hang:
            result = "hang"
        except Exception:
            result = "traceback"
            traceback.print_exc()
        counts[result] += 1
    return out


def peak_MB() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", nargs="?", type=Path, default=HERE.parent / "data" / "rope_spring")
    parser.add_argument("--faults", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--show", action="store_true", help="name each silent change by its seed")
    args = parser.parse_args()
    start = time.monotonic()
    table = fuzz_faults(args.campaign, args.faults, args.seed, args.show)
    heads = ("refused", "warned", "harmless", "silent", "traceback", "hang", "message of several lines")
    print(f"{'fault':20s} " + " ".join(f"{h:>9.9s}" for h in heads))
    for name, counts in sorted(table.items()):
        print(f"{name:20s} " + " ".join(f"{counts[h]:9d}" for h in heads))
    total = sum(table.values(), Counter())
    print(f"{'all':20s} " + " ".join(f"{total[h]:9d}" for h in heads))
    print(f"peak memory {peak_MB():.0f} MB, {time.monotonic() - start:.0f} s")


if __name__ == "__main__":
    main()
