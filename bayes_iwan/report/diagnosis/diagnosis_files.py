"""A diagnosis as files: `diagnosis.json`, `fits.json`, the page and the figures."""

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayes_iwan.campaign import Campaign
from bayes_iwan.campaign.folders.folder import folder_of
from bayes_iwan.diagnosis.answer.diagnosis_json import write_answer
from bayes_iwan.diagnosis.answer.localisation import (
    along_cycle,
    of_blocks,
    right_model_of_blocks,
)
from bayes_iwan.diagnosis.answer.result import Diagnosis
from bayes_iwan.diagnosis.answer.wording import listed
from bayes_iwan.diagnosis.diagnosis import diagnose_campaign
from bayes_iwan.diagnosis.fits.gap_size import gap_power_N2
from bayes_iwan.diagnosis.fits.residuals import ALONG
from bayes_iwan.files import clear, results_folder
from bayes_iwan.report.diagnosis import budget_figures
from bayes_iwan.report.diagnosis.budget_figures import CycleResidual
from bayes_iwan.report.diagnosis.diagnosis_page import write_diagnosis_page
from bayes_iwan.report.diagnosis.gap_figures import GapPictures, figures_of_gap
from bayes_iwan.report.page import provenance
from bayes_iwan.report.rendering import Renderer
from bayes_iwan.report.style import house_style
from bayes_iwan.report.viewer import effect_viewer_data


def figures_of_diagnosis(found: Diagnosis) -> dict[str, Callable[[], Figure]]:
    """What draws each figure of a diagnosis, by name, in N and mm."""
    gap, where = GapPictures(found.residual.data.loops, found.where, found.before), found.where
    out = figures_of_gap(gap)
    verdict, budget = found.verdict, found.budget
    out["probabilities"] = partial(budget_figures.probabilities_figure, verdict.probabilities, verdict.names)
    causes = listed(verdict.names) if 0 < len(verdict.names) < 3 else "all named causes" if verdict.names else ""
    after = along_cycle(found.after_residual, found.after_residual.value) if verdict.causes else None
    average = [
        CycleResidual(name, where.phase_N[t], None if after is None else after[t], where.expected_N[t])
        for t, name in enumerate(gap.names)
    ]
    if verdict.causes:
        out["before_after"] = partial(budget_figures.before_after_figure, average, causes)
        out["moved"] = partial(budget_figures.moved_figure, found.moved)
        out["shares"] = partial(budget_figures.shares_figure, budget)
    shown = _changing(found, gap.names) or (average[int(np.argmax(gap.gap_N))],)
    out["headline"] = partial(budget_figures.headline_figure, budget, shown, causes, verdict.one_of)
    return out


def _changing(found: Diagnosis, names: Sequence[str]) -> tuple[CycleResidual, ...]:
    """Residual in the first and the last block of cycles of the test that changes most, where most of the gap is
    change along the record, which the average cycle does not show; else nothing."""
    several = [t for t, x in enumerate(found.residual.data.loops) if len(x.block_cycle) > 1]  # blocks of cycles
    if not several or found.before.along.rms_N <= found.before.loop.rms_N:
        return ()
    power_N2 = gap_power_N2(found.residual, (ALONG,))
    test = max(several, key=lambda t: float(power_N2[t]))
    cycle = found.residual.data.loops[test].block_cycle
    half = 0.5 * float(cycle[1] - cycle[0])
    before = of_blocks(found.residual, found.residual.value, test)
    after = of_blocks(found.after_residual, found.after_residual.value, test) if found.verdict.causes else None
    expected = right_model_of_blocks(found.residual, test, found.seed)
    shown = []
    for b in (0, len(cycle) - 1):
        span = f"cycles {cycle[b] - half + 1:.0f} to {cycle[b] + half:.0f}"
        left = None if after is None else after[b]
        shown.append(CycleResidual(span if b else f"{names[test]}, {span}", before[b], left, expected[b]))
    return tuple(shown)


def write_diagnosis(
    campaign: Campaign | str | os.PathLike[str], out: str | os.PathLike[str], *, overwrite: bool = False, **options: Any
) -> Diagnosis:
    """Diagnose a campaign and write everything into `out`; options as for
    :func:`bayes_iwan.diagnosis.diagnosis.diagnose_campaign`."""
    with results_folder(out, "diagnose", folder_of(campaign), overwrite=overwrite) as folder:
        found = diagnose_campaign(campaign, **options)
        _write(found, folder)
    return found


def write_found(found: Diagnosis, out: Path, overwrite: bool = False) -> Path:
    """Write a diagnosis that was made before; returns the page."""
    with results_folder(out, "diagnose", found.campaign.path, overwrite=overwrite) as folder:
        return _write(found, folder)


@house_style()
def _write(found: Diagnosis, folder: Path) -> Path:
    renderer = Renderer(aside=True)
    figures = {name: draw() for name, draw in figures_of_diagnosis(found).items()}  # in N and mm: the page relabels
    clear(folder, "diagnosis.json", "diagnosis.html", "fits.json")
    made, viewer = provenance(found.campaign, found.seed), effect_viewer_data(found) if found.verdict.causes else None
    page = write_diagnosis_page(found, figures, folder / "diagnosis.html", made, renderer, viewer)
    write_answer(found, folder)  # last: where it stands, all of them do
    return page
