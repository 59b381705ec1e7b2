"""What stands below each figure of a diagnosis, and what a reader who cannot see it is told."""

#: caption and description of each figure, in the order in which they stand
CAPTIONS = {
    "headline": (
        "Left: the gap as a sum, from the whole gap down to the rest, the records' noise beside it. Right: what the "
        "model misses in the test where it misses most, along one cycle; the grey band is what a right model leaves.",
        "Waterfall of the gap and the residual force of one test with and without the named causes",
    ),
    "budget": (
        "The gap as a sum: how much of it each named cause removes (Shapley values, so that effects that overlap "
        "share fairly) and what is left.",
        "Waterfall from the gap down to the rest",
    ),
    "gap_loops": (
        "Measured loops of every test. Red and thick: the measured force is above the model's there; blue: "
        "below; thin and grey: nothing is missed. After each name the gap as a share of the friction force.",
        "Hysteresis loops coloured by measured minus predicted force",
    ),
    "gap_map": (
        "The same along the cycle (across) for every test (down), divided by what a right model would leave "
        "(its standard deviation from noise, from small misfits and after a refit).",
        "Colour map of the missed force over phase and test",
    ),
    "gap_regions": (
        "Parts of the loop. A point right of the dashed line: more is missed there than in the loop as a "
        "whole. Grey and open: no more than a right model would leave.",
        "Points with intervals: gap in each part of the loop",
    ),
    "gap_harmonics": (
        "Harmonics of what is missed, test by test. Left: in step with the displacement, where a missing "
        "stiffness or mass shows; right: in step with the velocity, where missing damping shows.",
        "Stems of residual harmonics for all tests, in phase and in quadrature",
    ),
    "gap_growth": (
        "Gap of each test against frequency and amplitude, with 90 % intervals. Open marks: no more than a "
        "right model would leave.",
        "Gap against frequency and against amplitude, logarithmic",
    ),
    "gap_cycles": (
        "Gap in successive blocks of cycles. Level lines: what is missing does not change along the record.",
        "Gap against cycle number for every test",
    ),
    "probabilities": (
        "Probability that each effect contributes. “None”: the model needs nothing more. “Unknown”: what is left "
        "has a cause that is not in the catalogue. Several effects may contribute, so these need not sum to one.",
        "Bar chart of the probability that each effect contributes",
    ),
    "before_after": (
        "What is missed along the cycle by the model alone and with the named causes, everything fitted anew.",
        "Residual force along the cycle of every test with and without the causes",
    ),
    "shares": (
        "Share of the gap that each named cause removes. The diamond counts: tests that the fit has not seen.",
        "Share of the gap by cause with intervals, on fitted and on unseen tests",
    ),
    "moved": (
        "Change of the specimen's own parameters once the causes are in the model. Long stems: these had been bent to "
        "imitate them.",
        "Change of each parameter in standard deviations",
    ),
}
