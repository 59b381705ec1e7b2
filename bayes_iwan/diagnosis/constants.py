"""Every constant of the diagnosis that was chosen rather than derived, each with unit and reason.

`analyses/ablate_diagnosis.py` says what each brings (`analyses/ablation.md`).
"""

from typing import Final

# ---- what the records are compared with (fitting)

#: share of the friction level by which a contrast along the record may differ without a cause, per harmonic
TREND_FLOOR: Final = 0.002
#: power over white noise's at which a line of the mains stands out
LINE_STANDS: Final = 25.0
#: share of the friction level beyond which a discrepancy is the less likely, p(ln a) ∝ 1/(1 + (a/LARGE_DISCREPANCY)²):
#: else one record's discrepancy, of few harmonics, grows to the friction force itself and leaves nothing to tell
LARGE_DISCREPANCY: Final = 0.1
#: sd of the logarithm of a harmonic's variance over the smooth discrepancy's
SPECTRUM_SD: Final = 1.4
#: share of the friction level beside which, at most, the least gap in newtons is sought: beside a larger discrepancy
#: priors hold a model where it misses far more than it must
LARGEST_DISCREPANCY: Final = 0.05

# ---- the score of a set of effects (search/search_result.py)

#: nats: an effect must gain so much to be in a set; the logarithm of how many effects and laws compete for its place,
#: twice, since evidence and newtons both count what it gains
EFFECT_NATS: Final = 8.0
#: nats that two effects cost together that look alike: nature seldom has both
ALIKE_NATS: Final = 25.0
#: nats of the logarithm of the gap in newtons, for each test: two for one harmonic, twice as many since half of what
#: evidence says of two laws is true of neither
NEWTON_NATS: Final = 4.0
#: a sound specimen's usual gap over the friction force: a smaller gap scores no more
USUAL_GAP: Final = 0.004

# ---- how far the search goes (search/model_search.py)

#: single effects are refitted if they promise PROMISE nats or, where the gap is more than a sound specimen's, are among
#: so many most promising ones
SINGLE_MOST: Final = 7
#: nats that one Gauss–Newton step must promise for an effect to be refitted
PROMISE: Final = 6.0
#: sets of each size that grow (from those of one effect the base is fitted again), and effects that each is tried with
BEAM: Final = 2
BRANCH: Final = 4
#: effects in a set, at most; model-form effects are not counted
MOST_EFFECTS: Final = 4
#: what removes less of the friction force is not named: two sensors of one kind differ by as much
LEAST_OF_FRICTION: Final = 0.001

# ---- numbers that no cause has (assessment/indicators.py)

#: prior standard deviations beyond which a number is not plausible
LARGEST_SCORE: Final = 4.0
#: periods of the slowest test that a time constant of a cycle's signals may last
LONGEST_PERIODS: Final = 3.0
#: largest over smallest frequency, of tests of one amplitude, that tells how a force follows frequency
CLOCK_SPREAD: Final = 1.15

# ---- the verdict (assessment/verdict.py)

#: what is said to be so is more probable than not: a named effect, a cause of what is left, that nothing is needed
PROBABLE: Final = 0.5
#: probability, at most, of what something speaks against; 0.1 and 0.5 change nothing that was measured
#: (analyses/ablation.md)
REFUSED: Final = 0.25
#: share of the gap that an effect must remove to be named (what is said must matter); of a cause in the base's form,
#: which always removes some
LEAST_SHARE: Final = 0.02
LEAST_MODEL_FORM: Final = 0.2
#: what a single record shows by itself: a line of the mains, a level that the force does not pass, a zero that moves
SHOWN_BY_RECORD: Final = frozenset({"mains_interference", "force_clipping", "force_drift"})
#: share of the friction force by which cycles differ beyond which no law that repeats is the whole cause; up to 0.0065
#: on sound specimens of the virtual rig (slow noise of the sensors)
NOT_REPEATING: Final = 0.01
#: share of a gap, most of which has no name, that an effect must remove alone to be suspected, and how many are said
SUSPECT: Final = 0.5
SUSPECTS_MOST: Final = 6

# ---- probabilities (assessment/calibration.py; those of the unexplained part are fitted, in calibration.json)

#: scores of sets count by the power α/(α + tests), this α: so the tests together count little more than a third of one
COARSENED: Final = 0.35
#: no answer claims more
SUREST: Final = 0.99
