"""The page of a diagnosis: the answer first, then where, which, how far it shrinks, what moved, what is tied."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.diagnosis.answer.diagnosis_json import INVISIBLE, ceiling_shrink
from bayes_iwan.diagnosis.answer.gap_findings import where_sentences
from bayes_iwan.diagnosis.answer.result import Diagnosis
from bayes_iwan.diagnosis.answer.sentences import not_excluded, remedy
from bayes_iwan.diagnosis.answer.wording import few, force, interval, listed, percent, plain, title
from bayes_iwan.diagnosis.assessment.budget import Kind
from bayes_iwan.diagnosis.fits.gap_size import Gap
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
    found: Diagnosis,
    figures: Mapping[str, Figure],
    path: str | os.PathLike[str],
    made: Provenance | None = None,
    renderer: Renderer | None = None,
    viewer: dict[str, Any] | None = None,
) -> Path:
    """Write the page; whole or not at all.

    figures : by name (see `CAPTIONS`), those missing are omitted; made : from what and when; viewer : of
    :func:`bayes_iwan.report.effect_loops.effect_viewer_data`.
    """
    page = Page(
        f"Diagnosis: {found.campaign.name}",
        "What the model misses, what makes it, what is left and the next test",
        "Every number here is in diagnosis.json.",
        found.campaign.units,
        made,
        renderer,
    )
    diagnosis_answer(page.section("Answer"), found, figures)
    _where(page.section(WHERE), found, figures)
    _which(page.section("Which cause"), found, figures)
    how_far = page.section("How far the gap shrinks")
    _how_far(how_far, found, figures)
    if viewer is not None:
        add_viewer(page, how_far, viewer)
    _moved(page.section("How the identified parameters moved"), found, figures)
    _next(page.section("What these tests cannot tell"), found)
    _settings(page.section("Settings and definitions"), found)
    return page.write(path)


def _yes(yes: bool) -> str:
    return "yes" if yes else "no"


def _where(section: Section, found: Diagnosis, figures: Mapping[str, Figure]) -> None:
    w, clock = found.where, found.campaign.clock
    section.bullets(where_sentences(w))
    put_figures(section, figures, *(n for n in WHERE_FIGURES if "headline" in figures or n != "gap_loops"))

    def size(gap: Gap) -> tuple[str, str, str]:
        return force(gap.rms_N), interval((gap.low_N, gap.high_N), force), percent(gap.share)

    rows = [("all tests", "", "", *size(found.budget.before), "")]
    stands_out = [x.significant or y.significant for x, y in zip(w.of("test"), w.of("trend"))]
    rows += [
        (file, f"{f:.3g}", f"{a:.3g}", *size(gap), _yes(out))
        for file, f, a, gap, out in zip(w.files, w.frequency_hz, w.amplitude_mm, found.before.tests, stands_out)
    ]
    head = ("test", "frequency, Hz", "amplitude, mm", "gap (RMS)", "90 % interval", "share of friction", "stands out")
    shown = [tuple(row) if clock else (row[0], *row[2:]) for row in (head, *rows)]
    section.table(shown[0], shown[1:], "The gap of each test", fold=len(rows) > 16)
    section.table(
        ("part of the loop", "gap (RMS)", "share of the gap", "share of the time", "stands out"),
        [(x.name, force(x.gap_N), percent(x.share), percent(x.time), _yes(x.significant)) for x in w.of("region")],
        "Parts of the loop",
        fold=True,
    )
    section.table(
        ("harmonic", "with displacement", "with velocity", "stands out"),
        [
            (str(order), force(p.gap_N), force(q.gap_N), _yes(p.significant or q.significant))
            for order, (p, q) in enumerate(zip(w.of("in phase"), w.of("quadrature")), start=1)
        ],
        "Harmonics of the residual (RMS over tests)",
        fold=True,
    )


def _which(section: Section, found: Diagnosis, figures: Mapping[str, Figure]) -> None:
    put_figures(section, figures, "probabilities")
    verdict = found.verdict
    if verdict.causes:
        _sampled(section, found)
    else:
        section.text("No effect is named.")
    for cause in verdict.causes:
        effect, f = found.search.effects[cause.name][0], cause.figures
        section.heading_below(title(cause.name)).text(effect.physics)
        if cause.law:
            section.text(f"Law that fits best: {cause.law}.")
        section.text(f"In the loops: {effect.signature}.")
        section.table(
            ("parameter", "mean", "sd", "90 % interval", "unit"),
            [
                (name, plain(x.mean, 4), plain(x.sd, 4), f"{plain(x.q05, 4)} to {plain(x.q95, 4)}", x.unit)
                for name, x in found.parameters[cause.name].items()
            ],
            f"{title(cause.name)}: fitted together with the specimen's own parameters",
        )
        section.text(f"It gains {f.gain:.0f} nats of score over the model without it.")
        if said := remedy(found, cause.name):
            section.text(f"Remedy: {said}")
        section.text(f"Source: {effect.reference}.")
    for one in verdict.one_of:
        section.text(
            f"One of {few(one.names)} contributes (probability {one.probability:.2f}) and removes {percent(one.share)} "
            "of the gap. Each of them alone is too improbable to be named."
        )
    places = {f.name: f for f in found.found.figures}
    considered = []
    for name in not_excluded(found):
        x = places.get(name)
        cells = ("–",) * 2 if x is None else (percent(x.fitted), percent(x.held_out))
        considered.append((title(name), f"{verdict.probabilities[name]:.2f}", *cells))
    if considered:
        section.table(
            ("effect", "probability", "shrink", "on held-out tests"),
            considered,
            "Considered, not named",
        )
    if failed := found.search.failed:
        section.table(("effect", "why"), [(title(n), why) for n, why in failed.items()], "Effects that failed")


def _sampled(section: Section, found: Diagnosis) -> None:
    """What the numbers of the effects come from."""
    s = found.sampling
    if s is None:
        section.text("Their numbers are the optimum's with Laplace's approximation: a quick run draws no samples.")
        return
    quality = "" if s.least_ess is None else f" At least {s.least_ess:.0f} effective draws"
    quality += "" if s.worst_r_hat is None else f", R-hat at most {s.worst_r_hat:.3f}."
    if s.converged:
        section.text(f"Their numbers are from draws of the posterior, converged.{quality}")
    else:
        section.note(
            "The draws behind their numbers have not converged, so take their intervals with care: "
            f"{s.message.removeprefix('not converged: ')}.{quality}",
            "warning",
        )


def _how_far(section: Section, found: Diagnosis, figures: Mapping[str, Figure]) -> None:
    b = found.budget
    section.text(
        f"The gap is {force(b.before.rms_N)} RMS without and {force(b.after.rms_N)} with all named effects. On the "
        "tests that it was fitted to an effect seems better than it is. The held-out tests count. A smooth discrepancy "
        f"of any shape would remove {100 * ceiling_shrink(found):.0f} % of the gap. No effect can be expected to "
        "remove more."
    )
    put_figures(section, figures, "budget", "shares", "before_after")


def _moved(section: Section, found: Diagnosis, figures: Mapping[str, Figure]) -> None:
    if not found.moved:
        section.text("No effect is named, so the identified values stay as they are.")
        return
    section.text(
        "Without the named effects the base model changes its own parameters to imitate them. These are the values "
        "without and with the effects."
    )
    put_figures(section, figures, "moved")
    meanings = {p.name: p.description for p in found.fit.problem.prior.free}
    section.table(
        ("parameter", "without", "with", "sd", "unit", "what it is"),
        [
            (n, plain(m.before, 4), plain(m.after, 4), plain(m.sd, 4), m.unit, meanings.get(n, "–"))
            for n, m in found.moved.items()
        ],
        "Identified parameters without and with the named effects",
    )


def _next(section: Section, found: Diagnosis) -> None:
    verdict, following = found.verdict, found.next_test
    section.heading_below("Cannot be described apart")
    tied, some = [c for c in verdict.causes if c.tied_with], verdict.one_of
    section.text(
        *(f"These tests do not separate {title(c.name)} from {listed(c.tied_with)}." for c in tied),
        *(f"One of {listed(x.names, 'or')} contributes; these tests cannot tell which." for x in some),
        *(() if tied or some else ("No other effect explains these tests nearly as well as a named one.",)),
    )
    rows = [
        (x.what, title(e.name), _yes(e.name in x.tied), percent(x.without), percent(e.share))
        for x in found.imitations
        for e in x.explanations
    ]
    if rows:
        section.table(
            ("dependence", "explained by", "possible", "gap without, of friction", "gap with, of friction"),
            rows,
            "What the base model's own freedoms can imitate",
        )
    if found.edges:
        section.table(
            ("parameter", "value", "unit", "prior sd from the median", "prior"),
            [(x.name, plain(x.value, 4), x.unit, f"{x.deviations:+.1f}", x.prior) for x in found.edges],
            "Base parameters far from plausible",
        )
    section.heading_below("Next test")
    if verdict.kind is Kind.DRIVE:
        section.note("Run these tests again with sines.")
    elif following is None:
        section.text("No further test would separate these effects better.")
    else:
        pair = " from ".join(title(x) for x in following.separates)
        at = "" if following.frequency_hz is None else f"{plain(following.frequency_hz)} Hz at "
        test = f"{at}{plain(following.amplitude_mm)} mm for {following.cycles} cycles"
        odds = f"{following.expected_log_odds:.1f} expected log odds (5 is strong evidence)"
        if following.bench:
            section.note(f"At the bench: {following.bench}.")
            section.text(f"No loop test separates {pair} well; the best would be {test}, with {odds}.")
        else:
            section.note(f"Run {test}: it separates {pair}, with {odds}.")
    section.heading_below("Not testable with these data")
    if found.needs_clock:
        section.text(f"Without a clock nothing can be said of: {listed(found.needs_clock)}.")
    section.text(
        f"Had one of these been there, these tests would not have shown it: {listed(found.not_testable)}. They are not "
        "ruled out."
        if found.not_testable
        else "Every effect of the catalogue would have shown at its usual size."
    )
    section.heading_below("What no loop test can see").note(INVISIBLE, "warning")
    asked = {n for c in verdict.causes for n in (c.name, *c.tied_with)} | {n for x in some for n in x.names}
    effects = {n: laws[0] for n, laws in found.search.effects.items() if n in asked}
    if benches := [(title(n), e.bench) for n, e in effects.items() if e.bench]:
        section.table(("effect", "what on the bench would show it"), benches, "At the bench")


def _settings(section: Section, found: Diagnosis) -> None:
    whole, parts = found.budget.before, found.before
    section.text(
        "Residual: measured − predicted force. Gap: its RMS with the records' own repeatability taken off, so "
        "that a perfect model reads zero within its interval; as a share it is divided by the RMS friction "
        "force. The mean force of a test is omitted: it depends on the rest position, which a dynamic "
        "displacement channel does not tell.",
        f"A part “stands out” when its gap is significant at 5 %, corrected for {found.where.count} statistics.",
    )
    rows = [("seed", str(found.seed)), ("quick run", _yes(found.quick))]
    rows += [
        (label, force(size_N))
        for label, size_N in (
            ("residual, RMS, noise included", whole.residual_N),
            ("noise, RMS", whole.noise_N),
            ("gap in the averaged loops", parts.loop.rms_N),
            ("gap along the records", parts.along.rms_N),
            ("gap by mains interference", parts.mains.rms_N),
            ("gap of the mean forces (not counted)", parts.mean.rms_N),
        )
    ]
    rows += [(f"model: {k}", str(v)) for k, v in found.settings.as_dict()["model"].items()]
    section.table(("setting", "value"), rows, "Settings")
