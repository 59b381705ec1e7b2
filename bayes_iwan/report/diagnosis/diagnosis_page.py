"""The page of a diagnosis: the answer first, then where, which, how far it shrinks, what moved, what is tied."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.diagnosis.answer.wording import few, force, interval, listed, percent, plain, title
from bayes_iwan.report.diagnosis.answer_box import diagnosis_answer, put_figures
from bayes_iwan.report.identification.viewer import add_viewer
from bayes_iwan.report.page import Page, Provenance, Section
from bayes_iwan.report.rendering import Renderer

#: heading of the section that shows the gap whatever its causes, and its figures
WHERE = "Where the model misses"
WHERE_FIGURES = ("gap_loops", "gap_map", "gap_regions", "gap_harmonics", "gap_growth", "gap_cycles")


def order_ahead(figures: Mapping[str, Figure], units: Units, renderer: Renderer) -> None:
    """Order the gap's own figures as the page will, before there is one."""
    put_figures(Page("", units=units, renderer=renderer).section(WHERE), figures, *WHERE_FIGURES)


def write_diagnosis_page(
    diagnosis: Mapping[str, Any],
    figures: Mapping[str, Figure],
    path: str | os.PathLike[str],
    about: Mapping[str, Mapping[str, Any]] | None = None,
    units: Units | None = None,
    made: Provenance | None = None,
    meanings: Mapping[str, str] | None = None,
    renderer: Renderer | None = None,
    viewer: dict[str, Any] | None = None,
) -> Path:
    """Write the page; whole or not at all.

    diagnosis : what `diagnosis.json` holds; figures : by name (see `CAPTIONS`), those missing are omitted; about :
    by effect, what it is: physics, signature, reference, bench. units : of the campaign; made : from
    what and when; meanings : of the specimen's parameters, by name. viewer : of
    :func:`bayes_iwan.report.effect_loops.effect_viewer_data`.
    """
    d, about = diagnosis, about or {}
    page = Page(
        f"Diagnosis: {d.get('campaign', 'campaign')}",
        "What the model misses, what makes it, what is left and the next test",
        "Every number here is in diagnosis.json.",
        units,
        made,
        renderer,
    )
    diagnosis_answer(page.section("Answer"), d, figures)
    _where(page.section(WHERE), d, figures)
    _which(page.section("Which cause"), d, figures, about)
    how_far = page.section("How far the gap shrinks")
    _how_far(how_far, d, figures)
    if viewer is not None:
        add_viewer(page, how_far, viewer)
    _moved(page.section("How the identified parameters moved"), d, figures, meanings or {})
    _next(page.section("What these tests cannot tell"), d, about)
    _settings(page.section("Settings and definitions"), d)
    return page.write(path)


def _where(section: Section, d: Mapping[str, Any], figures: Mapping[str, Figure]) -> None:
    gap, w = d["gap"], d["where"]
    found = w.get("sentences", [])
    if found:
        items = Markup("").join(Markup("<li>{}</li>").format(x) for x in found)
        section.html(Markup("<ul>{}</ul>").format(items))
    put_figures(section, figures, *(n for n in WHERE_FIGURES if "headline" in figures or n != "gap_loops"))
    clock = d.get("clock", True)
    frequencies = [f"{t['frequency_hz']:.3g}" if clock else "" for t in w["tests"]]
    whole = {"rms": gap["before_rms_N"], "interval": gap["before_interval_N"], "share": gap["before_share"]}
    rows = [("all tests", "", "", force(whole["rms"]), interval(whole["interval"], force), percent(whole["share"]), "")]
    rows += [
        (
            t["file"],
            f,
            f"{t['amplitude_mm']:.3g}",
            force(t["gap_rms_N"]),
            interval(t.get("interval_N"), force),
            percent(t["share"]),
            "yes" if t["significant"] else "no",
        )
        for t, f in zip(w["tests"], frequencies)
    ]
    head = ("test", "frequency, Hz", "amplitude, mm", "gap (RMS)", "90 % interval", "share of friction", "stands out")
    shown = [tuple(row) if clock else (row[0], *row[2:]) for row in (head, *rows)]
    section.table(shown[0], shown[1:], "The gap of each test", fold=len(rows) > 16)
    section.table(
        ("part of the loop", "gap (RMS)", "share of the gap", "share of the time", "stands out"),
        [
            (
                r["region"],
                force(r["gap_rms_N"]),
                percent(r["share_of_gap"]),
                percent(r.get("share_of_time")),
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
            (str(h["order"]), force(h["in_phase_N"]), force(h["quadrature_N"]), "yes" if h["significant"] else "no")
            for h in w["harmonics"]
        ],
        "Harmonics of the residual (RMS over tests)",
        fold=True,
    )


def _which(
    section: Section, d: Mapping[str, Any], figures: Mapping[str, Figure], about: Mapping[str, Mapping[str, Any]]
) -> None:
    put_figures(section, figures, "probabilities")
    if d["effects"]:
        _sampled(section, d)
    for effect in d["effects"]:
        name = effect["name"]
        cause = next(c for c in d["verdict"]["causes"] if c["name"] == name)
        section.heading_below(title(name))
        described = about.get(name, {})
        section.text(*(described[k] for k in ("physics",) if described.get(k)))
        if cause["law"]:
            section.text(f"Law that fits best: {cause['law']}.")
        if described.get("signature"):
            section.text(f"In the loops: {described['signature']}.")
        rows = [
            (p, plain(v["mean"], 4), plain(v["sd"], 4), f"{plain(v['q05'], 4)} to {plain(v['q95'], 4)}", v["unit"])
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
        if described.get("reference"):
            section.text(f"Source: {described['reference']}.")
    if not d["effects"]:
        section.text("No effect is named.")
    for one in d["verdict"].get("one_of") or []:
        section.text(
            f"One of {few(one['names'])} contributes (probability {one['probability']:.2f}) and removes "
            f"{percent(one['share'])} of the gap. Each of them alone is too improbable to be named."
        )
    rows = [
        (
            title(c["name"]),
            f"{c['probability']:.2f}",
            percent(c["shrink"]),
            percent(c["shrink_held_out"]),
            "–" if c["strength_differs_by"] is None else f"{c['strength_differs_by']:.1f}",
        )
        for c in d["considered"]
    ]
    if rows:
        section.table(
            ("effect", "probability", "shrink", "on held-out tests", "strength differs by (sd)"),
            rows,
            "Considered, not named",
        )
    if d["failed"]:
        section.table(("effect", "why"), [(title(n), w) for n, w in d["failed"].items()], "Effects that failed")


def _sampled(section: Section, d: Mapping[str, Any]) -> None:
    """What the numbers of the effects come from."""
    sampling = d.get("sampling")
    if sampling is None:
        section.text("Their numbers are the optimum's with Laplace's approximation: a quick run draws no samples.")
        return
    quality = "" if sampling["least_ess"] is None else f" At least {sampling['least_ess']:.0f} effective draws"
    quality += "" if sampling["worst_r_hat"] is None else f", R-hat at most {sampling['worst_r_hat']:.3f}."
    if sampling["converged"]:
        section.text(f"Their numbers are from draws of the posterior, converged.{quality}")
    else:
        section.note(
            f"The draws behind their numbers have not converged, so take their intervals with care: "
            f"{sampling['message'].removeprefix('not converged: ')}.{quality}",
            "warning",
        )


def _how_far(section: Section, d: Mapping[str, Any], figures: Mapping[str, Figure]) -> None:
    gap = d["gap"]
    section.text(
        f"The gap is {force(gap['before_rms_N'])} RMS without and {force(gap['after_rms_N'])} with all named "
        "effects. On the tests that it was fitted to an effect seems better than it is. The held-out tests count. A "
        f"smooth discrepancy of any shape would remove {100 * gap['ceiling_shrink']:.0f} % of the gap. No effect can "
        "be expected to remove more."
    )
    put_figures(section, figures, "budget", "shares", "before_after")


def _moved(section: Section, d: Mapping[str, Any], figures: Mapping[str, Figure], meanings: Mapping[str, str]) -> None:
    if not d["moved"]:
        section.text("No effect is named, so the identified values stay as they are.")
        return
    section.text(
        "Without the named effects the base model changes its own parameters to imitate them. These are the values "
        "without and with the effects."
    )
    put_figures(section, figures, "moved")
    section.table(
        ("parameter", "without", "with", "sd", "unit", "what it is"),
        [
            (n, plain(m["before"], 4), plain(m["after"], 4), plain(m["sd"], 4), m["unit"], meanings.get(n, "–"))
            for n, m in d["moved"].items()
        ],
        "Identified parameters without and with the named effects",
    )


def _next(section: Section, d: Mapping[str, Any], about: Mapping[str, Mapping[str, Any]]) -> None:
    verdict, following = d["verdict"], d["next_test"]
    section.heading_below("Cannot be described apart")
    tied = [c for c in verdict["causes"] if c["tied_with"]]
    some = verdict.get("one_of") or []
    section.text(
        *(f"These tests do not separate {title(c['name'])} from {listed(c['tied_with'])}." for c in tied),
        *(f"One of {listed(x['names'], 'or')} contributes; these tests cannot tell which." for x in some),
        *(() if tied or some else ("No other effect explains these tests nearly as well as a named one.",)),
    )
    rows = [
        (
            x["what"],
            title(e["name"]),
            "yes" if e["name"] in x["tied"] else "no",
            percent(x["without"]),
            percent(e["share"]),
        )
        for x in d["imitations"]
        for e in x["explanations"]
    ]
    if rows:
        section.table(
            ("dependence", "explained by", "possible", "gap without, of friction", "gap with, of friction"),
            rows,
            "What the base model's own freedoms can imitate",
        )
    far = [
        (x["name"], plain(x["value"], 4), x["unit"], f"{x['deviations']:+.1f}", x["prior"])
        for x in d["far_from_plausible"]
    ]
    if far:
        section.table(
            ("parameter", "value", "unit", "prior sd from the median", "prior"),
            far,
            "Base parameters far from plausible",
        )
    section.heading_below("Next test")
    if verdict["kind"] == "drive":
        section.note("Run these tests again with sines.")
    elif following is None:
        section.text("No further test would separate these effects better.")
    else:
        pair = " from ".join(title(x) for x in following["separates"])
        at = following["frequency_hz"]
        test = "" if at is None else f"{plain(at)} Hz at "
        test += f"{plain(following['amplitude_mm'])} mm"
        test += f" for {following['cycles']} cycles" if following.get("cycles") else ""
        odds = f"{following['expected_log_odds']:.1f} expected log odds (5 is strong evidence)"
        if following.get("bench"):
            section.note(f"At the bench: {following['bench']}.")
            section.text(f"No loop test separates {pair} well; the best would be {test}, with {odds}.")
        else:
            section.note(f"Run {test}: it separates {pair}, with {odds}.")
    section.heading_below("Not testable with these data")
    hidden, clocked = verdict["not_testable"], verdict["needs_clock"]
    if clocked:
        section.text(f"Without a clock nothing can be said of: {listed(clocked)}.")
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
    asked = {n for c in verdict["causes"] for n in (c["name"], *c["tied_with"])}
    asked |= {n for x in some for n in x["names"]}
    benches = [(title(n), a["bench"]) for n, a in about.items() if a.get("bench") and n in asked]
    if benches:
        section.table(("effect", "what on the bench would show it"), benches, "At the bench")


def _settings(section: Section, d: Mapping[str, Any]) -> None:
    gap = d["gap"]
    section.text(
        "Residual: measured − predicted force. Gap: its RMS with the records' own repeatability taken off, so "
        "that a perfect model reads zero within its interval; as a share it is divided by the RMS friction "
        "force. The mean force of a test is omitted: it depends on the rest position, which a dynamic "
        "displacement channel does not tell.",
        "A part “stands out” when its gap is significant at 5 %, corrected for "
        f"{d['where'].get('statistics', 'all')} statistics.",
    )
    rows = [("seed", str(d["seed"])), ("quick run", "yes" if d.get("quick") else "no")]
    rows += [
        (label, force(gap[key]))
        for key, label in (
            ("residual_rms_N", "residual, RMS, noise included"),
            ("noise_rms_N", "noise, RMS"),
            ("averaged_loop_rms_N", "gap in the averaged loops"),
            ("along_record_rms_N", "gap along the records"),
            ("mains_rms_N", "gap by mains interference"),
            ("mean_force_rms_N", "gap of the mean forces (not counted)"),
        )
        if gap.get(key) is not None
    ]
    rows += [(f"model: {k}", str(v)) for k, v in (d.get("base") or {}).items()]
    section.table(("setting", "value"), rows, "Settings")
