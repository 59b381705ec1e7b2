"""What was true of a withheld case, from either form in which truths are written.

Ours: {"kind", "effects": [{"name", "law", "size", "visible_share", "share", ...}], "true_gap_N", "specimen", "noise",
"design"}.
The first sealed set came from another rig: {"kind": "none" or a name, "second": a name, "effect": {number: value},
"raw_share", "noise", "tests"}. That rig's force clipping took its limit per record, and its direction-dependent
friction acted on the elements' stiffness too: no specimen has such laws, and cases with either are counted apart.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from bayes_iwan import former_names
from bayes_iwan.diagnosis.assessment.budget import subsets
from bayes_iwan.virtual_rig.cases import KINDS
from bayes_iwan.virtual_rig.faults import CATALOGUE
from bayes_iwan.withheld.sealed import WithheldError
from bayes_iwan.withheld.true_gaps import by_set, removed

#: laws of the first set's rig that no specimen has
UNPHYSICAL = ("force_clipping", "direction_dependent_friction")


@dataclass(frozen=True)
class PlantedCause:
    """One true cause: `law` "" if not said; `size`, `visible` (what no other specimen imitates) as shares of friction.

    `share`: its part of the gap that all of a case's causes leave. nan for what the truth does not say.
    """

    name: str
    law: str = ""
    size: float = float("nan")
    visible: float = float("nan")
    share: float = float("nan")

    @property
    def listed(self) -> bool:
        """Whether the diagnosis' catalogue has it."""
        return self.name in CATALOGUE


@dataclass(frozen=True)
class Truth:
    """A case's truth: its kind (one of `rig.cases.KINDS`), its causes, force noise as a share of friction, how many
    frequencies its tests have, the specimen's family of slip forces, whether its rig had an impossible law, and the
    gap, N, by set of its faults (empty where the truth does not say)."""

    kind: str
    causes: tuple[PlantedCause, ...]
    noise: float
    frequencies: int
    family: str
    faulty: bool
    gap_N: Mapping[frozenset[str], float] = field(default_factory=dict)

    @property
    def listed(self) -> tuple[PlantedCause, ...]:
        """The causes that the catalogue has."""
        return tuple(c for c in self.causes if c.listed)

    def shares(self, named: Collection[str]) -> dict[str, float]:
        """True share of the gap of each cause, for an answer that names these: what the gap loses with the named ones
        out of the rig, the others there; where the gaps are not known, its part of what all leave."""
        known = frozenset(named) & {c.name for c in self.causes}
        if self.gap_N and all(frozenset(c.name for c in self.causes) - k in self.gap_N for k in subsets(known)):
            return removed(self.gap_N, known)
        return {c.name: c.share for c in self.causes}

    def seen(self, cause: PlantedCause) -> bool:
        """Whether a cause leaves a gap above the noise once the specimen's parameters have moved; True if not known."""
        return not cause.visible <= self.noise


def json_number(value: object) -> float:
    """A JSON number, nan for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return float("nan")
    try:
        return float(value)
    except OverflowError:  # JSON's whole numbers have no end
        return float("nan")


def read_truth(name: str, truth: Mapping[str, object]) -> Truth:
    """A case's truth from its JSON. Raises `WithheldError` that names the case if it is of neither form."""
    try:
        return _ours(truth) if "effects" in truth else _first_set(truth)
    except (KeyError, TypeError, AttributeError, ValueError, StopIteration) as error:
        raise WithheldError(f"the truth of {name} is of no known form ({type(error).__name__}: {error})") from None


def _ours(truth: Mapping[str, Any]) -> Truth:
    causes = []
    for e in truth["effects"]:
        size = json_number(e.get("size"))
        visible = size * json_number(e.get("visible_share"))
        share = json_number(e.get("share")) if len(truth["effects"]) > 1 else 1.0
        causes.append(
            PlantedCause(former_names.EFFECTS.get(e["name"], e["name"]), e.get("law", ""), size, visible, share)
        )
    if truth["kind"] not in KINDS:
        raise KeyError(f"kind {truth['kind']!r}")
    noise = truth.get("noise")
    tests, gaps = truth.get("design", {}).get("tests", []), truth.get("true_gap_N") or {}
    return Truth(
        kind=truth["kind"],
        causes=tuple(causes),
        noise=json_number(noise.get("share_of_friction")) if isinstance(noise, Mapping) else float("nan"),
        frequencies=len({t["frequency_hz"] for t in tests if t.get("role", "fit") == "fit"}),
        family=str(truth.get("specimen", {}).get("family", "")),
        faulty=False,
        gap_N=by_set({former_names.parameters_in(k): json_number(v) for k, v in gaps.items()}),
    )


def _first_set(truth: Mapping[str, Any]) -> Truth:
    names = [former_names.EFFECTS.get(n, n) for n in (truth["kind"], truth.get("second")) if n and n != "none"]
    known, unknown = (sum((n in CATALOGUE) is listed for n in names) for listed in (True, False))
    kind = next(k for k, counts in KINDS.items() if counts == (known, unknown))
    size, share = (json_number(truth.get("raw_share")), 1.0) if len(names) == 1 else (float("nan"), float("nan"))
    return Truth(
        kind=kind,
        causes=tuple(PlantedCause(n, size=size, share=share) for n in names),
        noise=json_number(truth.get("noise")),
        frequencies=len({f for f, _ in truth.get("tests", [])}),
        family=str(truth.get("base", {}).get("family", "")),
        faulty=any(n in UNPHYSICAL for n in names),
    )
