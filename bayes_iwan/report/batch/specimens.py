"""What a batch of specimens says together: populations, lots, who is unusual, values shrunk within lots."""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.comparison.shrinkage import Shrunk, shrunk
from bayes_iwan.comparison.unusual import Unusual, rank_unusual
from bayes_iwan.errors import InputError, few, nearest, not_utf8
from bayes_iwan.inference.results.population import Population, SpecimenDraws, population
from bayes_iwan.report.page import Cell, Table
from bayes_iwan.screen import Listed, Named, on_screen, screen

#: of the draws, as columns call them
_QUANTILES = ("q05", "q50", "q95")


class BatchError(InputError):
    """A batch that cannot be begun; the message says why."""


@dataclass(frozen=True)
@on_screen
class Quantity:
    """One identifiable quantity of one specimen: its unit, median and 90 % interval, and draws (with the prior's)."""

    label: str
    unit: str
    median: float
    low: float
    high: float
    draws: Array
    prior: Array


@dataclass(frozen=True)
@on_screen
class Finished:
    """One specimen that was finished: what was identified (if asked for) and the cause found (if asked for).

    converged : None where nothing was sampled.
    """

    name: str
    seconds: float
    converged: bool | None
    message: str
    quantities: Mapping[str, Quantity]
    cause: str | None
    second_cause: str | None
    probability: float | None
    gap_share: float | None
    shrink: float | None
    residual_share: float | None = None


@dataclass(frozen=True)
@on_screen
class LotDifference:
    """One quantity of lot a against lot b: the typical value's ratio a/b where it is positive (`relative`), else the
    difference a − b; median and 90 % interval, and the probability that a's is larger."""

    quantity: str
    a: str
    b: str
    relative: bool
    median: float
    low: float
    high: float
    larger: float


@dataclass(frozen=True, repr=False)
@on_screen
class Batch:
    """All specimens.

    finished, failures : those that were finished, and the reason of each failure. populations : of each quantity that
    at least three specimens determine. unusual : every specimen, the most unusual first. group : name of what lots are
    distinguished by; lots : of each specimen; lot_populations : by lot and quantity. shrunk : by quantity and specimen,
    what all others of its lot (of the batch, without lots) say of it.
    """

    finished: tuple[Finished, ...]
    failures: Mapping[str, str]
    populations: Mapping[str, Population]
    unusual: tuple[Unusual, ...] = ()
    group: str = ""
    lots: Mapping[str, str] = field(default_factory=dict)
    lot_populations: Mapping[str, Mapping[str, Population]] = field(default_factory=dict)
    shrunk: Mapping[str, Mapping[str, Shrunk]] = field(default_factory=dict)

    def __repr__(self) -> str:
        head = [f"{len(self.finished)} specimens finished, {len(self.failures)} failed"]
        head += [f"  failed: {n}: {reason[:80]}" for n, reason in list(self.failures.items())[:5]]
        odd = [x for x in self.unusual if x.notable][:5]
        tail = [f"  unusual: {x.name} (distance {x.distance:.1f}) in {', '.join(x.notable[:4])}" for x in odd]
        rows = [
            f"  {name:28s} {p.typical[0]:.4g} ({p.typical[1]:.4g} to {p.typical[2]:.4g})"
            for name, p in self.populations.items()
        ]
        return screen(head, rows, tail, ".populations")

    def label(self, quantity: str) -> str:
        """A quantity as figures and tables name it."""
        return next(x.quantities[quantity].label for x in self.finished if quantity in x.quantities)

    def spread_unit(self, quantity: str) -> tuple[float, str]:
        """What a quantity's spread between specimens is multiplied by, and the unit that it then has: "%" (of the
        typical value), or the quantity's own."""
        if self.populations[quantity].relative:
            return 100.0, "%"
        unit = next(x.quantities[quantity].unit for x in self.finished if quantity in x.quantities)
        return 1.0, unit.removeprefix("-")

    def quantities(self) -> list[str]:
        """Names of everything that was identified of at least one specimen."""
        return list(dict.fromkeys(q for x in self.finished for q in x.quantities))

    def outliers(self) -> dict[str, tuple[str, ...]]:
        """Quantities in which a specimen stands out from the others, by specimen, the most unusual first."""
        return Named({x.name: x.notable for x in self.unusual if x.notable})

    def differences(self) -> tuple[LotDifference, ...]:
        """Every pair of lots with a population of their own, quantity by quantity."""
        out = []
        for a, b in combinations(sorted(self.lot_populations), 2):
            of_a, of_b = self.lot_populations[a], self.lot_populations[b]
            for q in (q for q in of_a if q in of_b):
                relative = of_a[q].relative and of_b[q].relative
                # both were drawn with one seed: side by side they would move together
                x, y = of_a[q].typical_draws, np.roll(of_b[q].typical_draws, 1)
                low, middle, high = (float(v) for v in np.quantile(x / y if relative else x - y, [0.05, 0.5, 0.95]))
                out.append(LotDifference(q, a, b, relative, middle, low, high, larger=float(np.mean(x > y))))
        return Listed(out)

    def table(self) -> Table:
        """One row a specimen, failed ones included."""
        words = ["specimen", "state", "message", "cause", "second_cause", "unusual_in", "lot"]
        columns = [*words[:3], "seconds", *words[3:5], "probability", "gap_share", "shrink", "residual_share"]
        columns += ["distance", *words[5:]]
        columns += [f"{q}_{s}{lot}" for q in sorted(self.quantities()) for lot in ("", "_lot") for s in _QUANTILES]
        ranked = {x.name: x for x in self.unusual}
        rows: list[dict[str, Cell]] = []
        for x in self.finished:
            row: dict[str, Cell] = {c: getattr(x, c) for c in columns[2:10]}
            row |= {"specimen": x.name, "state": "not converged" if x.converged is False else "finished"}
            if odd := ranked.get(x.name):
                row |= {"distance": odd.distance, "unusual_in": " ".join(odd.notable)}
            for name, q in x.quantities.items():
                row |= {f"{name}_{s}": v for s, v in zip(_QUANTILES, (q.low, q.median, q.high))}
                if (lot := self.shrunk.get(name, {}).get(x.name)) and lot.usable:
                    row |= {f"{name}_{s}_lot": getattr(lot, s) for s in _QUANTILES}
            rows.append(row)
        rows += [{"specimen": n, "state": "failed", "message": reason} for n, reason in self.failures.items()]
        empty: dict[str, Cell] = {c: "" if c in words else np.nan for c in columns}
        for row in rows:
            row["lot"] = self.lots.get(str(row["specimen"]))
        filled = [tuple(empty[c] if row.get(c) is None else row[c] for c in columns) for row in rows]
        head = tuple(self.group or "lot" if c == "lot" else c for c in columns)
        return Table("batch", head, tuple(sorted(filled, key=lambda r: str(r[0]))))


def lots_of(folder: Path, group: str, names: Sequence[str]) -> dict[str, str]:
    """The lot of each of the specimens `names`, from a column of FOLDER/specimens.csv.

    Raises BatchError where the file, its column "specimen" or that of the lots is missing, or it names others.
    """
    path = folder / "specimens.csv"
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise BatchError(f"{path} {not_utf8(error)}") from None
    except OSError:
        raise BatchError(
            f'{path}: cannot be read; --group {group} takes lots from it: write a line "specimen,{group}" and below it '
            "a line for each campaign folder"
        ) from None
    head = text.splitlines()[0] if text.strip() else ""
    rows = list(csv.DictReader(io.StringIO(text), delimiter=";" if ";" in head else ","))
    for name in ("specimen", group):
        if not rows or name not in rows[0]:
            known = nearest(name, rows[0]) if rows else "; it has no rows"
            raise BatchError(f'{path}: has no column "{name}"; add it, or name another with --group{known}')
    names_in_rows = [str(row["specimen"]).strip() for row in rows]
    lots = dict(zip(names_in_rows, (str(row[group] or "").strip() for row in rows)))
    said = []
    if twice := [x for x in lots if names_in_rows.count(x) > 1]:
        said.append(f"several lines for {few(twice)}: delete all but one")
    if without := [x for x in names if x not in lots]:
        said.append(f"no line for the campaign folder {few(without)}: add it, with no {group} where none is known")
    if unknown := [x for x in lots if x not in names]:
        said.append(f"no campaign folder {few(unknown)}: fix the name or delete the line")
    if said:
        raise BatchError(f"{path}: {'; '.join(said)}")
    return lots


def summarised(
    finished: tuple[Finished, ...], failures: Mapping[str, str], seed: int, group: str, lots: Mapping[str, str]
) -> Batch:
    """All that is said across specimens: populations, lots, who is unusual, and values shrunk within lots."""
    every = populations(finished, seed)
    by_lot = {}
    for lot in sorted({lots[x.name] for x in finished if lots.get(x.name)}):
        by_lot[lot] = populations(tuple(x for x in finished if lots.get(x.name) == lot), seed)
    towards: dict[str, dict[str, Shrunk]] = {}
    for found in by_lot.values() if group else [every]:
        for q, p in found.items():
            some = [x for x in finished if x.name in p.names]
            draws = [SpecimenDraws(x.name, x.quantities[q].draws, x.quantities[q].prior) for x in some]
            towards.setdefault(q, {}).update(shrunk(draws, p))
    return Batch(finished, failures, every, rank_unusual(every), group, lots, by_lot, towards)


def populations(finished: tuple[Finished, ...], seed: int = 0) -> dict[str, Population]:
    """The population of every quantity that at least three specimens determine."""
    out = {}
    for name in dict.fromkeys(q for x in finished for q in x.quantities):
        of = [(x.name, x.quantities[name]) for x in finished if name in x.quantities]
        found = population([SpecimenDraws(n, q.draws, q.prior) for n, q in of], seed)
        if found is not None:
            out[name] = found
    return out
