"""The head of a diagnosis' page: the verdict and the waterfall, the gap as a sum, and what the words mean."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from bayes_iwan.gap.words import listed, title
from bayes_iwan.report.cells import percent, percent_range
from bayes_iwan.report.diagnosis_captions import CAPTIONS
from bayes_iwan.report.page import Section

#: colour of the verdict's box
_BOX = {"none": "good", "explained": "good", "unknown": "warning", "drive": "warning"}
_WORDS = (
    ("gap", "the misfit: RMS of measured − predicted force beyond the records' noise (a stop has a clearance)", "N"),
    ("share", "part of the gap that a cause removes; all causes and the rest make the whole", ""),
    ("rest", "what no named cause removes", ""),
    ("noise", "RMS of what the records do not repeat", "N"),
    ("a right model leaves", "what noise and a real specimen's usual small misfit would leave", "N"),
    ("tests left out", "tests that the fit has not seen: whole frequencies and amplitudes in turn", ""),
    ("probability", "that a cause contributes; several may, so these need not sum to one", ""),
    ("shrink", "1 − gap after ÷ gap before", ""),
    ("u, A", "displacement, and its amplitude", "mm"),
    ("phase", "place in the cycle, 0 where the displacement crosses its middle upwards", ""),
    ("nats", "natural logarithm of how much more probable the records are with a cause than without", ""),
    ("sd", "standard deviation", ""),
)  # fmt: skip


def put_figures(section: Section, figures: Mapping[str, Figure], *names: str) -> None:
    """Those of these figures that there are, with their captions."""
    for name in names:
        if name in figures:
            section.figure(figures[name], *CAPTIONS[name], name=name)


def diagnosis_answer(section: Section, d: Mapping[str, Any], figures: Mapping[str, Figure]) -> None:
    """The verdict in words, the waterfall, the gap as a sum, where the rest sits, and the words that follow."""
    section.note(Markup("<br>").join(d["sentences"]), _BOX.get(d["verdict"]["kind"], "note"))
    put_figures(section, figures, *(("headline",) if "headline" in figures else ("gap_loops",)))
    if d["verdict"]["causes"]:
        section.table(
            ("part of the gap", "probability", "share", "90 % interval", "on tests left out", "90 % interval",
             "cannot be told from"),
            [*map(_cause, d["verdict"]["causes"]), _rest(d)],
            "The gap as a sum",
        )  # fmt: skip
    where = d["rest"]["where"] if d["verdict"]["unknown_rest"] else []
    if where:
        section.heading_below("Where the rest sits")
        section.html(Markup("<ul>{}</ul>").format(Markup("").join(Markup("<li>{}</li>").format(x) for x in where)))
    section.heading_below("Words and symbols of this page")
    section.symbols(_WORDS)


def _cause(c: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        title(c["name"]),
        f"{c['probability']:.2f}",
        percent(c["share"]),
        percent_range(c["share_interval"]),
        percent(c["share_held_out"]),
        percent_range(c["share_held_out_interval"]),
        listed(c["cannot_tell_apart"]) if c["cannot_tell_apart"] else "–",
    )


def _rest(d: Mapping[str, Any]) -> tuple[str, ...]:
    rest = d["rest"]
    name = "rest" + (", cause unknown" if d["verdict"]["unknown_rest"] else "")
    return name, f"{rest['probability']:.2f}", percent(rest["share"]), percent_range(rest["interval"]), "", "", ""
