"""Other sets of effects in which a search could as well have ended.

A search grows step by step and its refits end in one of several valleys, so that among sets that are worth all but the
same the one that it ends in hangs on a seed, and on rounding. What is said of an effect should not: it is judged in the
company of each of them (Occam's window: Madigan and Raftery 1994, doi:10.1080/01621459.1994.10476894).
"""

from __future__ import annotations

import numpy as np

from bayes_iwan.gap.fitting.evidence import Fit
from bayes_iwan.gap.searching.base import WORTH_NATS
from bayes_iwan.gap.searching.explored import Explored

#: by about so many nats refits of one set of effects from other starts differ: what a set is worth is not known better
SPREAD = 10.0
#: ends beside the chosen one, at most
OTHERS_MOST = 2


def ends_of(found: Explored, chosen: Fit, most: int) -> dict[frozenset[str], float]:
    """Weight of the chosen set, which comes first, and of the likeliest others of at most `most` effects: those that
    are worth all but as much or more, and where no effect more or less is known to be worth it."""
    if not chosen.effects:
        return {chosen.names: 1.0}
    some = {k: f for k, f in found.fits.items() if k and len(k) <= most and found.needed(k)}
    near = found.within_reach([chosen, *some.values()])
    worth = dict(zip((f.names for f in near), found.worths(near))) | {chosen.names: found.worth(chosen)}

    def at_an_end(names: frozenset[str]) -> bool:
        larger = [v for k, v in worth.items() if names < k and len(k) == len(names) + 1]
        smaller = [v for k, v in worth.items() if k < names and len(k) == len(names) - 1]
        least = max((*(v - WORTH_NATS for v in larger), *(v + WORTH_NATS for v in smaller)), default=-np.inf)
        return worth[names] > least

    others = sorted((k for k in worth if k != chosen.names and at_an_end(k)), key=lambda k: -worth[k])[:OTHERS_MOST]
    best = max(worth[k] for k in (chosen.names, *others))
    return {
        k: float(np.exp((worth[k] - best) / SPREAD))
        for k in (chosen.names, *others)
        if k == chosen.names or worth[k] > best - SPREAD
    }
