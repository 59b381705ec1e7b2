"""What the faults of a case make of the gap, from the rig itself: the gap that the base model leaves with some of the
faults removed, and the share of it that is gone with each.

An answer says what the gap loses with its named effects in the model. The truth beside it is what the gap loses, in
newtons, with these faults out of the rig, the others still there.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from bayes_iwan.campaign import average
from bayes_iwan.diagnosis.answer.saved_fits import LOOPS
from bayes_iwan.diagnosis.assessment.budget import shares_of, subsets
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.search.base_fit import fit_base, gap_rms_N
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.virtual_rig.cases import Case, simulate

GapByFaults = Mapping[frozenset[str], float]


def true_gaps_N(case: Case, seed: int) -> dict[frozenset[str], float]:
    """RMS gap, N, of the base model refitted to the same tests with some of the faults, by every set of them; nothing
    for a case without any. seed : of the fits' starts."""

    def gap_N(some: frozenset[str]) -> float:
        fewer = replace(case, faults=tuple(f for f in case.faults if f.name in some), sealed=())
        loops = [average(r, **LOOPS) for r in simulate(fewer)[0] if r.role != "held-out"]
        data = gap_data(loops)
        return gap_rms_N(data, fit_base(data, DiagnoseSettings(), scales_of(loops), np.random.default_rng(seed)))

    names = [f.name for f in case.faults]
    return {some: gap_N(some) for some in subsets(names)} if names else {}


def removed(gap_N: GapByFaults, some: Collection[str]) -> dict[str, float]:
    """Share of the gap that would be gone with each of some faults, all others there: what an answer says that names
    these and no others. As :func:`shares_of` divides it."""
    whole = max(gap_N, key=len, default=frozenset())
    if not gap_N:
        return dict.fromkeys(some, 0.0)
    return shares_of(some, {k: gap_N[whole - k] for k in subsets(some)})


def by_name(gap_N: GapByFaults) -> dict[str, float]:
    """As JSON holds it: sets as their names, joined by "+"."""
    return {"+".join(sorted(names)): value for names, value in gap_N.items()}


def by_set(named: Mapping[str, float]) -> dict[frozenset[str], float]:
    """The inverse of :func:`by_name`."""
    return {frozenset(name.split("+")) if name else frozenset(): value for name, value in named.items()}
