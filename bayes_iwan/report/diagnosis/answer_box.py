"""The head of a diagnosis' page: the verdict and the waterfall, the gap as a sum, and what the words mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple

from markupsafe import Markup
from matplotlib.figure import Figure

from bayes_iwan.diagnosis.answer.diagnosis_json import FITTED
from bayes_iwan.diagnosis.answer.result import Diagnosis
from bayes_iwan.diagnosis.answer.sentences import colour, sentences
from bayes_iwan.diagnosis.answer.wording import few, interval, percent, title
from bayes_iwan.diagnosis.assessment.budget import Cause, Share
from bayes_iwan.report.page import Section

_WORDS = (
    ("gap", "RMS of measured − predicted force beyond the records' noise (a stop has a clearance)", "N"),
    ("share", "part of the gap that an effect removes; all effects and the unexplained part make the whole", ""),
    ("interval of a share", "what the effect may remove, by the tests, by overlap, and by the form of its law", ""),
    ("friction force", "RMS friction force of the fitted model, at least energy per cycle / (4 × amplitude)", "N"),
    ("unexplained", "what no named effect removes", ""),
    ("noise", "RMS of what the records do not repeat", "N"),
    ("expected residual", "what noise and the usual small discrepancy of a sound specimen leave", "N"),
    ("held-out tests", "tests that the fit has not seen: each group of like tests in turn", ""),
    ("probability", "that a cause contributes; several may, so these need not sum to one", ""),
    ("shrink", "1 − gap after ÷ gap before", ""),
    ("u, A", "displacement, and its amplitude", "mm"),
    ("phase", "place in the cycle, 0 where the displacement crosses its middle upwards", ""),
    ("nats", "natural logarithm of how much more probable the records are with a cause than without", ""),
    ("sd", "standard deviation", ""),
)  # fmt: skip

#: what stands below each figure of a diagnosis, and what stands in its place for who cannot see it
CAPTIONS = {
    "headline": (
        "Left: the gap as a sum, from the whole gap down to the unexplained part, noise beside it; hatched: what of "
        "it one of several effects removes, where these tests cannot tell which. Right: what the model misses "
        "in the test where it misses most, along one cycle (where most of the gap is change along the record: in the "
        "first and the last cycles); the grey band is the expected residual.",
        "Waterfall of the gap and the residual force of one test with and without the named effects",
    ),
    "budget": (
        "The gap as a sum: how much of it each named effect removes and what stays unexplained. Where effects overlap, "
        "a share is the mean of what the effect removes as the only one and as the last one.",
        "Waterfall from the gap down to the unexplained part",
    ),
    "gap_loops": (
        "Measured loops of every test. Red and thick: the measured force is above the model's there; blue: "
        "below; thin and grey: no gap. After each name the gap as a share of the friction force.",
        "Hysteresis loops coloured by measured minus predicted force",
    ),
    "gap_map": (
        "The same along the cycle (across) for every test (down), divided by the expected residual "
        "(standard deviation from noise and small discrepancies, after a refit).",
        "Colour map of the residual force over phase and test",
    ),
    "gap_regions": (
        "Parts of the loop, which overlap: their shares of the gap, at the right, add up to more than the whole. A "
        "point right of the dashed line: the residual is larger there than in the whole loop. Grey and open: no more "
        "than a right model would leave.",
        "Points with intervals: gap in each part of the loop",
    ),
    "gap_harmonics": (
        "Harmonics of the residual, test by test. Left: in phase with displacement, where a missing "
        "stiffness or mass shows; right: in phase with velocity, where missing damping shows.",
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
        "Residual along the cycle by the model alone and with the named effects, everything fitted anew.",
        "Residual force along the cycle of every test with and without the effects",
    ),
    "shares": (
        "Share of the gap that each named cause removes. The diamond counts: tests that the fit has not seen.",
        "Share of the gap by cause with intervals, on fitted and on held-out tests",
    ),
    "moved": (
        "Change of the specimen's own parameters once the named effects are in the model. Long stems: these had "
        "changed to imitate them.",
        "Change of each parameter in standard deviations",
    ),
}


def put_figures(section: Section, figures: Mapping[str, Figure], *names: str) -> None:
    """Those of these figures that there are, with their captions."""
    for name in names:
        if name in figures:
            section.figure(figures[name], *CAPTIONS[name], name=name)


def diagnosis_answer(section: Section, found: Diagnosis, figures: Mapping[str, Figure]) -> None:
    """The verdict in words, the waterfall, the gap as a sum, where the unexplained part sits, and the words that
    follow."""
    verdict, unexplained = found.verdict, found.budget.unexplained
    section.note(Markup("<br>").join(sentences(found)), colour(found))
    put_figures(section, figures, *(("headline",) if "headline" in figures else ("gap_loops",)))
    if verdict.causes:
        left = "unexplained" + (", cause unknown" if verdict.unknown_cause else "")
        unexplained_row = (left, f"{unexplained.probability:.2f}", *_share(unexplained.share), "", "", "")
        section.table(
            ("part of the gap", "probability", "share", "90 % interval", "on held-out tests", "90 % interval",
             "tied with"),
            [*map(_cause, verdict.causes), unexplained_row],
            "The gap as a sum",
        )  # fmt: skip
        section.table(
            ("effect", "on", "with all", "without it", "it alone", "tests", "overlap", "law, down", "law, up"),
            [
                (title(c.name), c.held_out_by or FITTED, *map(percent, (c.gaps.with_all, c.gaps.without, c.gaps.alone)),
                 *map(percent, astuple(c.vague)))
                for c in verdict.causes
            ],
            "Three gaps an effect, and what makes its share vague",
        )  # fmt: skip
        section.text(
            "Every figure is a part of the model's own gap, which is 100 %. With all: what is left with all named "
            "effects in the model; without it: with all the others; it alone: with no other. An effect that matters "
            "leaves much without it and little alone. The right half says how far its share may be off: as it differs "
            "between tests (90 %), as other effects explain the same (half of first against last), and as its formula "
            "is not quite nature's (down: it removes less on held-out tests; up: the unexplained part may be its "
            "own). The root of the sum of their squares is the interval's half width."
        )
    if unexplained.where and verdict.unknown_cause and verdict.causes:  # else the next section says the same
        section.heading_below("Where the unexplained part sits").bullets(unexplained.where)
    section.heading_below("Words and symbols of this page")
    section.symbols(_WORDS)


def _share(share: Share | None) -> tuple[str, str]:
    return ("–", "–") if share is None else (percent(share.value), interval((share.low, share.high), percent))


def _cause(c: Cause) -> tuple[str, ...]:
    tied = few(c.tied_with) if c.tied_with else "–"
    return title(c.name), f"{c.probability:.2f}", *_share(c.share), *_share(c.held_out), tied
