"""The page of `bayes-iwan inspect`: what a campaign shows before any model, and what that means for identification."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bayes_iwan.campaign import Campaign
from bayes_iwan.campaign.folders.folder import read_checked
from bayes_iwan.campaign.folders.inspect import LEVEL, Inspection, inspect_loop
from bayes_iwan.campaign.timing.accelerometer import STATED
from bayes_iwan.report.identification.loops import test_name
from bayes_iwan.report.inspection import inspect_figures as figures
from bayes_iwan.report.page import Page, Section, provenance
from bayes_iwan.report.style import house_style

LEGEND = (
    ("u, A", "displacement and its amplitude (half the peak-to-peak of the averaged cycle)", "mm"),
    ("E", "energy lost a cycle: the area of the loop", "mJ"),
    ("k", "equivalent stiffness: fundamental of the force in phase with that of the displacement, over it", "N/mm"),
    ("η", "loss factor: the same in quadrature, over k; tan of the loss angle", "–"),
    ("noise", "RMS of what is left of the force between cycles, averaged cycle and slow changes taken off", "N"),
    ("distortion", "harmonics 2 to 10 of the displacement over its fundamental", "%"),
    ("reversal", "samples within the first tenth of the stroke after a turn, in one cycle", "–"),
)


def inspect_to(campaign: str | os.PathLike[str], out: str | os.PathLike[str] | None = None) -> str:
    """Inspect a campaign: its text, and with `out` a page inspect.html with figures as files beside it."""
    read, loops = read_checked(campaign)
    tests = tuple(inspect_loop(loop) for loop in loops)
    text = inspect_text(read, tests)
    if out is not None:
        write_page(read, tests, Path(out))
    return text


def _table(campaign: Campaign, tests: Sequence[Inspection]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Columns and rows, one a test; without a clock no frequency."""
    columns = COLUMNS if campaign.clock else tuple(c for c in COLUMNS if c != "f, Hz")
    return columns, [
        (
            t.loop.file,
            *((f"{t.loop.frequency_hz:.4g}",) if campaign.clock else ()),
            f"{t.loop.amplitude_mm:.4g}",
            f"{t.loop.n_cycles}",
            t.energy_mJ.text(),
            t.stiffness_N_mm.text(),
            t.loss_factor.text(3),
            f"{t.noise_N:.2g}",
            f"{100 * t.distortion:.2g}",
            f"{t.reversal_samples:.1f}",
        )
        for t in tests
    ]


COLUMNS = ("test", "f, Hz", "A, mm", "cycles", "E, mJ", "k, N/mm", "η", "noise, N", "distortion, %", "reversal")


def inspect_text(campaign: Campaign, tests: Sequence[Inspection]) -> str:
    """The table and every warning below its test, as text."""
    head, rows = _table(campaign, tests)
    columns = [campaign.units.text(c) for c in head]
    widths = [max(len(c), *(len(row[i]) for row in rows)) for i, c in enumerate(columns)]
    lines = ["  ".join(c.ljust(w) for c, w in zip(columns, widths)).rstrip()]
    for test, row in zip(tests, rows):
        lines.append("  ".join(c.ljust(w) for c, w in zip(row, widths)).rstrip())
        lines += [f"    {note}" for note in test.notes]
    lines.append(f"intervals: {100 * LEVEL:.0f} %, from the scatter of the cycles")
    if campaign.from_acceleration:
        lines.append(STATED)
    return "\n".join(lines)


@house_style()
def write_page(campaign: Campaign, tests: Sequence[Inspection], out: Path) -> Path:
    """Write out/inspect.html and its figures (out/figures/inspect_*.png and .pdf); returns the page's path."""
    units = campaign.units
    page = Page(
        f"What the records show: {campaign.name}",
        campaign.description,
        "No model was fitted and nothing drawn at random.",
        units,
        provenance(campaign),
    )
    _answer(page.section("Answer"), campaign, tests)

    def figure(heading: str, name: str, drawing: figures.Figure, text: str, caption: str, alt: str) -> None:
        section = page.section(heading).text(units.text(text))
        section.figure(drawing, units.text(caption), alt, name=name)

    figure(
        "Loops less the straight part",
        "friction",
        figures.loops(tests, units, linear=False),
        "A line through each loop is taken off (as in the paper's Fig. 3): what is left is friction, and whatever "
        "curves.",
        "Loops less their straight part.",
        "One panel a test: loops of the force left after a straight line is taken off.",
    )
    if campaign.clock:
        figure(
            "Across frequency",
            "overlays",
            figures.overlays(tests, units),
            "Tests of one amplitude over one another, less one common line (as in the paper's Fig. 4). "
            "Rate-independent friction gives one loop at all frequencies; loops that widen are viscous, loops that "
            "turn have inertia.",
            "Loops of one amplitude at all its frequencies.",
            "One panel an amplitude: loops of several frequencies drawn over one another.",
        )
    figure(
        "Energy, stiffness and damping",
        "trends",
        figures.trends(tests, units),
        f"Bars are {100 * LEVEL:.0f} % intervals from the scatter of the cycles; they are often smaller than the "
        "marks. Stiffness that falls with amplitude is slip.",
        "Energy lost a cycle, equivalent stiffness and loss factor against amplitude.",
        f"Three panels against amplitude{', one line a frequency' if campaign.clock else ''}.",
    )
    figure(
        "Noise",
        "noise",
        figures.noise(tests, units),
        "What is left of the force once every cycle's average is taken off. Averaging n cycles divides it by √n."
        + (" Dashed: lines at mains frequencies." if campaign.clock else ""),
        "Amplitude spectrum of the force's noise; the title gives its RMS.",
        f"One panel a test: noise against {'frequency' if campaign.clock else 'cycles'} on logarithmic axes.",
    )
    figure(
        "Over the cycles",
        "drift",
        figures.drift(tests, units),
        "Where force or energy move and the displacement does not, the specimen or the force channel changed; where "
        "the displacement moves, the drive did.",
        "Amplitude of displacement and force, and energy, of each cycle against their medians.",
        "One panel a test: three lines against the number of the cycle.",
    )
    figure(
        "The drive",
        "drive",
        figures.drive(tests, units),
        "Harmonics of the displacement that stand above its noise. The model is driven with the motion as it was, so a "
        "distorted drive does no harm; formulas for sines would.",
        "Harmonics of the displacement over its fundamental.",
        "Lines of the share of each harmonic, one a test.",
    )
    return page.write(out / "inspect.html")


def _answer(section: Section, campaign: Campaign, tests: Sequence[Inspection]) -> None:
    noted = [(test, note) for test in tests for note in test.notes]
    said = f"{len(noted)} remark(s) on the records: read them before anything is identified."
    section.status([(said, False, "") if noted else ("Nothing stands in the way of an identification.", True, "")])
    section.figure(
        figures.loops(tests, campaign.units),
        campaign.units.text(
            "Force over displacement. Grey: up to twelve single cycles of each test, spread over the record; black: "
            "their average. Grey that is wider than the line is noise or change from cycle to cycle."
        ),
        "One panel a test: closed loops of force over displacement.",
        name="loops",
    )
    rows = [
        ("tests", f"{len(tests)}"),
        *([("frequency", _between([t.loop.frequency_hz for t in tests], "Hz"))] if campaign.clock else []),
        ("amplitude", _between([t.loop.amplitude_mm for t in tests], "mm")),
        ("equivalent stiffness", _between([t.stiffness_N_mm.value for t in tests], "N/mm")),
        ("energy lost a cycle", _between([t.energy_mJ.value for t in tests], "mJ")),
        ("damping: loss factor", _between([t.loss_factor.value for t in tests])),
        ("noise over the force's RMS", _between([100 * t.noise_N / float(np.std(t.loop.force_N)) for t in tests], "%")),
    ]
    section.table(("what", "from smallest to largest of the tests"), rows, "The answer, before any model")
    if noted:
        section.table(
            ("test", "what, what it does, what to do"),
            [(test.loop.file, note) for test, note in noted],
            "Remarks on the records",
        )
    section.text("Symbols of this page:").symbols(LEGEND)
    section.table(
        *_table(campaign, tests), f"Tests; intervals in brackets: {100 * LEVEL:.0f} %, from the scatter of the cycles"
    )
    if campaign.from_acceleration:
        section.text(STATED)
    names = ", ".join(test_name(t.loop) for t in tests if t.loop.role == "held-out")
    if names:
        section.text(f"Held out of any fit: {names}.")


def _between(values: Sequence[float], unit: str = "") -> str:
    low, high = f"{min(values):.3g}", f"{max(values):.3g}"
    return (low if low == high else f"{low} to {high}") + (f" {unit}" if unit else "")
