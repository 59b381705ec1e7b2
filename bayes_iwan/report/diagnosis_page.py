"""The page of a diagnosis: the answer first, then where, which, how far it shrinks, what moved, what cannot be told."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from bayes_iwan.campaign.units import Units
from bayes_iwan.gap.words import listed, title
from bayes_iwan.report.page import Page, Section
from bayes_iwan.report.style import save

#: caption and description of each figure, in the order in which they stand
_CAPTIONS = {
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


def write_diagnosis_page(
    diagnosis: Mapping[str, Any],
    figures: Mapping[str, Figure],
    path: str | os.PathLike[str],
    about: Mapping[str, Mapping[str, Any]] | None = None,
    units: Units | None = None,
) -> Path:
    """Write the page; whole or not at all.

    diagnosis : what `diagnosis.json` holds; figures : by name (see `_CAPTIONS`), those missing are left out; about :
    by effect, what it is: physics, signature, reference, bench. units : of the campaign (default: mm and N).
    """
    d, about = diagnosis, about or {}
    page = Page(
        f"Diagnosis: {d.get('campaign', 'campaign')}",
        "What the model misses, what makes it, what is left and the next test",
        f"bayes_iwan, seed {d['seed']}. Every number here is in diagnosis.json.",
        units,
    )
    _answer(page.section("Answer"), d, figures)
    _where(page.section("Where the model misses"), d, figures)
    _which(page.section("Which cause"), d, figures, about)
    _how_far(page.section("How far the gap shrinks"), d, figures)
    _moved(page.section("How the identified parameters moved"), d, figures)
    _next(page.section("What these tests cannot tell"), d, about)
    _settings(page.section("Settings and definitions"), d)
    return page.write(path)


def write_figures(
    figures: Mapping[str, Figure], folder: str | os.PathLike[str], kinds: Sequence[str] = ("png", "svg")
) -> list[Path]:
    """Every figure as files NAME.png and NAME.svg (or .pdf) in a folder."""
    return [save(figure, Path(folder) / f"{name}.{kind}") for name, figure in figures.items() for kind in kinds]


def _draw(section: Section, figures: Mapping[str, Figure], *names: str) -> None:
    for name in names:
        if name in figures:
            caption, alt = _CAPTIONS[name]
            section.figure(figures[name], caption, alt)


def _answer(section: Section, d: Mapping[str, Any], figures: Mapping[str, Figure]) -> None:
    kind = {"none": "good", "unknown": "warning", "partly_explained": "note"}.get(d["verdict"]["kind"], "note")
    section.note(" ".join(d["sentences"]), kind)
    _draw(section, figures, *(("headline",) if "headline" in figures else ("gap_loops",)))
    causes = d["verdict"]["causes"]
    if causes:
        rows = [
            (
                title(c["name"]),
                f"{c['probability']:.2f}",
                _percent(c["share"]),
                _percents(c["share_interval"]),
                _percent(c["share_held_out"]),
                _percents(c["share_held_out_interval"]),
                listed(c["cannot_tell_apart"]) if c["cannot_tell_apart"] else "–",
            )
            for c in causes
        ]
        rest = d["rest"]
        rows.append(
            (
                "rest" + (", cause unknown" if d["verdict"]["unknown_rest"] else ""),
                f"{rest['probability']:.2f}",
                _percent(rest["share"]),
                _percents(rest["interval"]),
                "",
                "",
                "",
            )
        )
        section.table(
            ("part of the gap", "probability", "share", "90 % interval", "on tests left out", "90 % interval",
             "cannot be told from"),
            rows,
            "The gap as a sum",
        )  # fmt: skip
    where = d["rest"]["where"] if d["verdict"]["unknown_rest"] else []
    if where:
        section.heading_below("Where the rest sits")
        section.html(Markup("<ul>{}</ul>").format(Markup("").join(Markup("<li>{}</li>").format(x) for x in where)))


def _where(section: Section, d: Mapping[str, Any], figures: Mapping[str, Figure]) -> None:
    gap, w = d["gap"], d["where"]
    found = w.get("sentences", [])
    if found:
        items = Markup("").join(Markup("<li>{}</li>").format(x) for x in found)
        section.html(Markup("<ul>{}</ul>").format(items))
    names = [n for n in ("gap_loops", "gap_map", "gap_regions", "gap_harmonics", "gap_growth", "gap_cycles")]
    _draw(section, figures, *(n for n in names if "headline" in figures or n != "gap_loops"))
    rows = [
        (
            "all tests",
            "",
            "",
            _force(gap["before_rms_N"]),
            _range(gap["before_interval_N"]),
            _percent(gap["before_share"]),
            "",
        )
    ]
    rows += [
        (
            t["file"],
            f"{t['frequency_hz']:.3g}",
            f"{t['amplitude_mm']:.3g}",
            _force(t["gap_rms_N"]),
            _range(t.get("interval_N")),
            _percent(t["share"]),
            "yes" if t["significant"] else "no",
        )
        for t in w["tests"]
    ]
    section.table(
        ("test", "Hz", "mm", "gap (RMS)", "90 % interval", "share of friction", "stands out"),
        rows,
        "The gap of each test",
        fold=len(rows) > 16,
    )
    section.table(
        ("part of the loop", "gap (RMS)", "share of the gap", "share of the time", "stands out"),
        [
            (
                r["region"],
                _force(r["gap_rms_N"]),
                _percent(r["share_of_gap"]),
                _percent(r.get("share_of_time")),
                "yes" if r["significant"] else "no",
            )
            for r in w["regions"]
        ],
        "Parts of the loop",
        fold=True,
    )
    section.table(
        ("harmonic", "with displacement", "with velocity", "stands out"),
        [
            (str(h["order"]), _force(h["in_phase_N"]), _force(h["quadrature_N"]), "yes" if h["significant"] else "no")
            for h in w["harmonics"]
        ],
        "Harmonics of what is missed (RMS over tests)",
        fold=True,
    )


def _which(
    section: Section, d: Mapping[str, Any], figures: Mapping[str, Figure], about: Mapping[str, Mapping[str, Any]]
) -> None:
    _draw(section, figures, "probabilities")
    for effect in d["effects"]:
        name = effect["name"]
        cause = next(c for c in d["verdict"]["causes"] if c["name"] == name)
        section.heading_below(title(name))
        told = about.get(name, {})
        section.text(*(told[k] for k in ("physics",) if told.get(k)))
        if cause["law"]:
            section.text(f"Law that fits best: {cause['law']}.")
        if told.get("signature"):
            section.text(f"In the loops: {told['signature']}.")
        rows = [
            (
                p,
                _number(v["mean"]),
                _number(v["sd"]),
                f"{_number(v['q05'])} to {_number(v['q95'])}",
                v["unit"],
            )
            for p, v in effect["parameters"].items()
        ]
        section.table(
            ("parameter", "mean", "sd", "90 % interval", "unit"),
            rows,
            f"{title(name)}: fitted together with the specimen's own parameters",
        )
        section.text(
            f"It gains {effect['log_evidence']:.0f} nats over the model without it and leads the next effect of "
            f"another kind by {effect['lead']:.0f}; fitted on halves of the tests its strength differs by "
            f"{effect['strength_differs_by']:.1f} standard deviations."
        )
        if effect.get("remedy"):
            section.text(f"Remedy: {effect['remedy']}")
        if told.get("reference"):
            section.text(f"Source: {told['reference']}.")
    if not d["effects"]:
        section.text("No effect of the catalogue is named.")
    rows = [
        (
            title(c["name"]),
            f"{c['probability']:.2f}",
            _percent(c["shrink"]),
            _percent(c["shrink_held_out"]),
            "–" if c["strength_differs_by"] is None else f"{c['strength_differs_by']:.1f}",
        )
        for c in d["considered"]
    ]
    if rows:
        section.table(
            ("effect", "probability", "shrink", "on tests left out", "strength differs by (sd)"),
            rows,
            "Considered, not named",
        )
    if d["failed"]:
        section.table(("effect", "why"), [(title(n), w) for n, w in d["failed"].items()], "Effects that failed")


def _how_far(section: Section, d: Mapping[str, Any], figures: Mapping[str, Figure]) -> None:
    gap = d["gap"]
    section.text(
        f"The gap before is {_force(gap['before_rms_N'])} RMS, with all named causes {_force(gap['after_rms_N'])}. "
        "What a cause does on the tests that it was fitted to flatters it; the tests left out of the fit judge it. "
        f"The ceiling is {100 * gap['ceiling_shrink']:.0f} %: so far a smooth rest, free of any "
        "cause, closes the gap, and no added effect can be expected to close it further."
    )
    _draw(section, figures, "budget", "shares", "before_after")


def _moved(section: Section, d: Mapping[str, Any], figures: Mapping[str, Figure]) -> None:
    if not d["moved"]:
        section.text("No cause is named, so the identified values stand as they are.")
        return
    section.text(
        "A model without the causes bends its own parameters to imitate them. These are the specimen's without and "
        "with them."
    )
    _draw(section, figures, "moved")
    section.table(
        ("number", "without", "with", "sd", "unit"),
        [(n, _number(m["before"]), _number(m["after"]), _number(m["sd"]), m["unit"]) for n, m in d["moved"].items()],
        "Identified parameters without and with the causes",
    )


def _next(section: Section, d: Mapping[str, Any], about: Mapping[str, Mapping[str, Any]]) -> None:
    verdict, following = d["verdict"], d["next_test"]
    section.heading_below("Cannot be told apart")
    tied = [c for c in verdict["causes"] if c["cannot_tell_apart"]]
    section.text(
        *(f"These tests do not separate {title(c['name'])} from {listed(c['cannot_tell_apart'])}." for c in tied)
        or ("No named cause has a rival that explains these tests nearly as well.",)
    )
    section.heading_below("Next test")
    if following is None:
        section.text("None is needed to settle which of the catalogue's effects contribute.")
    else:
        pair = " from ".join(title(x) for x in following["separates"])
        test = f"{following['frequency_hz']:.3g} Hz at {following['amplitude_mm']:.3g} mm"
        test += f" for {following['cycles']} cycles" if following.get("cycles") else ""
        odds = f"{following['expected_log_odds']:.1f} expected log odds (5 is strong evidence)"
        if following.get("bench"):
            section.note(f"At the bench: {following['bench']}.")
            section.text(f"No loop test separates {pair} well; the best would be {test}, with {odds}.")
        else:
            section.note(f"Run {test}: it separates {pair}, with {odds}.")
    section.heading_below("Not testable with these data")
    hidden = verdict["not_testable"]
    section.text(
        f"Had one of these been there, these tests would not have shown it: {listed(hidden)}. They are not ruled out."
        if hidden
        else "Every effect of the catalogue would have shown at its usual size."
    )
    section.heading_below("What no loop test can see")
    section.note(
        d.get("cannot_be_seen")
        or "A gain error of the displacement channel is absorbed whole by the "
        "stiffnesses: no loop test can see it. Check the sensor against a known displacement.",
        "warning",
    )
    asked = {n for c in verdict["causes"] for n in (c["name"], *c["cannot_tell_apart"])}
    benches = [(title(n), a["bench"]) for n, a in about.items() if a.get("bench") and n in asked]
    if benches:
        section.table(("cause", "what on the bench would show it"), benches, "At the bench")


def _settings(section: Section, d: Mapping[str, Any]) -> None:
    gap = d["gap"]
    section.text(
        "Residual: measured − predicted force. Gap: its RMS with the records' own repeatability taken off, so "
        "that a perfect model reads zero within its interval; as a share it is divided by the RMS friction "
        "force. The mean force of a test is left out: it hangs on where the specimen rests, which a dynamic "
        "displacement channel does not tell.",
        "A place “stands out” when it misses more than a right model would leave there, so much that no "
        "such finding at all is expected in 19 of 20 campaigns; "
        f"{d['where'].get('statistics', 'all')} statistics are allowed for.",
    )
    rows = [("seed", str(d["seed"])), ("quick run", "yes" if d.get("quick") else "no")]
    rows += [
        (label, _force(gap[key]))
        for key, label in (
            ("residual_rms_N", "residual, RMS, noise included"),
            ("noise_rms_N", "noise, RMS"),
            ("averaged_loop_rms_N", "gap in the averaged loops"),
            ("along_record_rms_N", "gap along the records"),
            ("mains_rms_N", "gap at the mains' lines"),
            ("mean_force_rms_N", "gap of the mean forces (not counted)"),
        )
        if gap.get(key) is not None
    ]
    rows += [(f"model: {k}", str(v)) for k, v in (d.get("base") or {}).items()]
    section.table(("setting", "value"), rows, "Settings")


def _force(x: float | None) -> str:
    if x is None or x != x:
        return "–"
    return f"{x:.3g} N" if abs(x) >= 0.1 or x == 0 else f"{1e3 * x:.3g} mN"


def _range(pair: Sequence[float] | None) -> str:
    return "–" if not pair else f"{_force(pair[0])} to {_force(pair[1])}"


def _percent(x: float | None) -> str:
    if x is None or x != x:
        return "–"
    return f"{100 * x:.1f} %" if abs(x) < 0.1 else f"{100 * x:.0f} %"


def _percents(pair: Sequence[float] | None) -> str:
    return "–" if not pair else f"{_percent(pair[0])} to {_percent(pair[1])}"


def _number(x: float | None) -> str:
    return "–" if x is None or x != x else f"{x:.4g}"
