"""Every constant of the diagnosis that was chosen rather than derived, each with unit and reason.

`analyses/ablate_diagnosis.py` says what each is worth (`analyses/ablation.md`).
"""

from __future__ import annotations

from typing import Final

# ---- the score of a set of effects (searching/found.py)

#: nats: an effect must gain so much to be in a set; the logarithm of how many effects and laws compete for its place
EFFECT_NATS: Final = 3.0
#: nats that two effects cost together that look alike: nature seldom has both
ALIKE_NATS: Final = 12.0
#: nats of the logarithm of the gap in newtons, for each test: two for one harmonic, twice as many since half of what
#: evidence says of two laws is true of neither
NEWTON_NATS: Final = 4.0
#: a sound specimen's usual gap over the friction force: a smaller gap scores no more
USUAL_GAP: Final = 0.004

# ---- how far the search looks (searching/search.py)

#: single effects are refitted if they are among so many most promising ones or promise PROMISE nats, or are sudden
SINGLE_MOST: Final = 7
#: nats that one Gauss–Newton step must promise for an effect to be refitted
PROMISE: Final = 3.0
#: where this share of a gap is change along the record, all that acts there is refitted: one step of a fade that
#: recovers leads nowhere, though it may be the whole cause
CHANGING: Final = 0.3
#: sets of each size that grow, and effects that each is tried with
BEAM: Final = 2
BRANCH: Final = 4
#: effects in a set, at most; those that bend the base's own form are not counted
MOST_EFFECTS: Final = 4
#: rounds of dropping and exchanging
ROUNDS: Final = 2
#: what removes less of the friction force is not named: two sensors of one kind differ by as much
LEAST_OF_FRICTION: Final = 0.001
