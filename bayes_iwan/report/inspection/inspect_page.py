"""The page of `bayes-iwan inspect`: what a campaign shows before any model, and what that means for identification."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bayes_iwan.campaign import Campaign
from bayes_iwan.campaign.folders.folder import read_checked
from bayes_iwan.campaign.folders.inspect import LEVEL, Inspection, inspect_loop
from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.campaign.timing.accelerometer import STATED
from bayes_iwan.report.identification.loops import test_name
from bayes_iwan.report.inspection import inspect_figures as figures
from bayes_iwan.report.page import Finding, Page, Section, provenance
from bayes_iwan.report.style import house_style


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
    rows = []
    for t in tests:
        moved = (*((f"{t.loop.frequency_hz:.4g}",) if campaign.clock else ()), f"{t.loop.amplitude_mm:.4g}")
        found = (t.energy_mJ.text(), t.stiffness_N_mm.text(), t.loss_factor.text(3), f"{t.noise_N:.2g}")
        sampled = (f"{100 * t.distortion:.2g}", f"{t.reversal_samples:.1f}")
        rows.append((t.loop.file, *moved, f"{t.loop.n_cycles}", *found, *sampled))
    return columns, rows


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


class InspectionSection(Section[tuple[Campaign, Sequence[Inspection]]]):
    """r : the campaign and its tests as they were inspected."""

    template, draw, level = "inspect.html", figures, f"{100 * LEVEL:.0f} %"

    @property
    def units(self) -> Units:
        return self.r[0].units


class Answer(InspectionSection):
    heading, stated = "Answer", STATED

    @property
    def noted(self) -> list[tuple[str, str]]:
        return [(test.loop.file, note) for test in self.r[1] for note in test.notes]

    @property
    def found(self) -> list[Finding]:
        said = f"{len(self.noted)} remark(s) on the records: read them before anything is identified."
        return [Finding(said) if self.noted else Finding("Nothing stands in the way of an identification.", True)]

    def ranges(self) -> list[tuple[str, str]]:
        campaign, tests = self.r
        noise = [100 * t.noise_N / float(np.std(t.loop.force_N)) for t in tests]
        return [
            ("tests", f"{len(tests)}"),
            *([("frequency", _between([t.loop.frequency_hz for t in tests], "Hz"))] if campaign.clock else []),
            ("amplitude", _between([t.loop.amplitude_mm for t in tests], "mm")),
            ("equivalent stiffness", _between([t.stiffness_N_mm.value for t in tests], "N/mm")),
            ("energy lost a cycle", _between([t.energy_mJ.value for t in tests], "mJ")),
            ("damping: loss factor", _between([t.loss_factor.value for t in tests])),
            ("noise over the force's RMS", _between(noise, "%")),
        ]

    def table(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        return _table(*self.r)

    @property
    def held_out(self) -> str:
        return ", ".join(test_name(t.loop) for t in self.r[1] if t.loop.role == "held-out")


#: after the answer: figures alone, and words that stand in the template
SECTIONS = {
    "Friction": "Loops less the straight part",
    "Overlays": "Across frequency",
    "Trends": "Energy, stiffness and damping",
    "Noise": "Noise",
    "Drift": "Over the cycles",
    "Drive": "The drive",
}


@house_style()
def write_page(campaign: Campaign, tests: Sequence[Inspection], out: Path) -> Path:
    """Write out/inspect.html and its figures (out/figures/inspect_*.png and .pdf); returns the page's path."""
    title, footer = f"What the records show: {campaign.name}", "No model was fitted and nothing drawn at random."
    page = Page(title, campaign.description, footer, campaign.units, provenance(campaign))
    r = (campaign, tests)
    shown = (InspectionSection(r, *x) for x in SECTIONS.items() if x[0] != "Overlays" or campaign.clock)
    page.add(Answer(r), *shown)
    return page.write(out / "inspect.html")


def _between(values: Sequence[float], unit: str = "") -> str:
    low, high = f"{min(values):.3g}", f"{max(values):.3g}"
    return (low if low == high else f"{low} to {high}") + (f" {unit}" if unit else "")
