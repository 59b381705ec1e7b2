"""A diagnosis as files: `diagnosis.json`, `fits.json`, the page and the figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayes_iwan.arrays import Array
from bayes_iwan.diagnosis.answer.diagnosis_json import effects_described, to_dict, write_answer
from bayes_iwan.diagnosis.answer.gap_findings import GapPictures, pictures
from bayes_iwan.diagnosis.answer.gap_location import Located, ProgressListener
from bayes_iwan.diagnosis.answer.localisation import along_cycle, of_blocks, right_model_of_blocks
from bayes_iwan.diagnosis.answer.wording import listed
from bayes_iwan.diagnosis.diagnosis import BASES, Diagnosis, diagnose_folder
from bayes_iwan.diagnosis.fits.gap_size import gap_power_N2
from bayes_iwan.diagnosis.fits.residuals import ALONG
from bayes_iwan.files import clear, finite, owned
from bayes_iwan.inference.setup.config import Config, diagnose_settings_of
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.report.diagnosis import budget_figures, gap_figures
from bayes_iwan.report.diagnosis.budget_figures import CycleResidual
from bayes_iwan.report.diagnosis.diagnosis_page import order_ahead, write_diagnosis_page
from bayes_iwan.report.effect_loops import effect_viewer_data
from bayes_iwan.report.provenance import provenance
from bayes_iwan.report.rendering import Renderer, shared
from bayes_iwan.report.style import house_style, relabel

#: work of drawing (:func:`bayes_iwan.report.rendering.shared`) that takes about as long as weighing causes
WEIGHING = 11


class Ahead(ProgressListener):
    """Draws the gap's own figures in a second process while causes are weighed here."""

    def __init__(self) -> None:
        self.renderer = Renderer()
        self.figures: dict[str, Figure] = {}

    def searched(self) -> None:
        self.renderer = shared(busy=WEIGHING)

    @house_style()
    def located(self, found: Located) -> None:
        units = found.campaign.units
        self.figures = gap_figures.figures_of_gap(pictures(found.residual, found.where, found.size))
        for figure in self.figures.values():
            relabel(figure, units)
        order_ahead(self.figures, units, self.renderer)


def diagnosis_figures(found: Diagnosis, ahead: Mapping[str, Figure] | None = None) -> dict[str, Figure]:
    """Every figure of a diagnosis by name, in the campaign's own units; ahead : those that were made already."""
    drawn = pictures(found.residual, found.where, found.before)
    out = dict(ahead or gap_figures.figures_of_gap(drawn))
    verdict, budget = found.verdict, found.budget
    out["budget"] = budget_figures.budget_figure(budget, verdict.one_of)
    out["probabilities"] = budget_figures.probabilities_figure(verdict.probabilities, verdict.names)
    after, causes = None, ""
    if verdict.causes:
        causes = listed(verdict.names) if len(verdict.names) < 3 else "all named causes"
        after = along_cycle(found.after_residual, found.after_residual.value)
        out["before_after"] = budget_figures.before_after_figure(
            drawn.names, drawn.residual_N, after, drawn.expected_N, causes
        )
        out["moved"] = budget_figures.moved_figure(found.moved)
        out["shares"] = budget_figures.shares_figure(budget)
    shown = _changing(found, drawn.names) or (_average(drawn, after),)
    out["headline"] = budget_figures.headline_figure(budget, shown, causes, verdict.one_of)
    for figure in out.values():
        relabel(figure, found.campaign.units)
    return out


def _average(drawn: GapPictures, after_N: Array | None) -> CycleResidual:
    """Residual along the average cycle of the test where most is."""
    worst = int(np.argmax(drawn.gap_N))
    return CycleResidual(
        drawn.names[worst],
        drawn.residual_N[worst],
        None if after_N is None else after_N[worst],
        drawn.expected_N[worst],
    )


def _changing(found: Diagnosis, names: Sequence[str]) -> tuple[CycleResidual, ...]:
    """Residual in the first and the last block of cycles of the test that changes most, where most of the gap is
    change along the record, which the average cycle does not show; else nothing."""
    if found.before.along.rms_N <= found.before.loop.rms_N:
        return ()
    test = int(np.argmax(gap_power_N2(found.residual, (ALONG,))))
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


def diagnose_campaign(
    campaign: str | Path,
    out: str | Path,
    *,
    seed: int = 0,
    quick: bool = False,
    base: str = "generalized",
    config: DiagnoseSettings | Config = None,
    effects_file: str | Path | None = None,
    simulator_file: str | Path | None = None,
    progress: bool = True,
    executor: Executor | None = None,
) -> dict[str, Any]:
    """Diagnose a campaign folder and write everything into `out`; returns what `diagnosis.json` holds.

    base : a name of :data:`bayes_iwan.diagnosis.diagnosis.BASES`; config : TOML file as for `identify`; effects_file :
    a user's own effects, simulator_file : their own model; both are Python and are run; executor : from
    :func:`bayes_iwan.executors.opened`, to refit effects side by side. Raises ValueError (and its kinds)
    with one line that names what is wrong and the fix.
    """
    if base not in BASES:
        raise ValueError(f"--base {base}: not known; choose one of {', '.join(BASES)}")
    if config is not None and base != "generalized":
        raise ValueError(f"--base {base} and --config both choose a model; leave one of them out")
    if simulator_file is not None and base != "generalized":
        raise ValueError(f"--base {base} and --simulator both choose a model; leave one of them out")
    chosen = DiagnoseSettings(BASES[base]) if config is None else config
    settings = diagnose_settings_of(chosen, simulator_file is not None)
    found = write_diagnosis(
        campaign,
        out,
        settings=settings,
        seed=seed,
        quick=quick,
        effects_file=effects_file,
        simulator_file=simulator_file,
        progress=progress,
        executor=executor,
    )
    return finite(to_dict(found))


def write_diagnosis(
    campaign: str | Path,
    out: str | Path,
    *,
    settings: DiagnoseSettings,
    seed: int = 0,
    quick: bool = False,
    effects_file: str | Path | None = None,
    simulator_file: str | Path | None = None,
    progress: bool = True,
    executor: Executor | None = None,
) -> Diagnosis:
    """Diagnose a campaign folder and write everything into `out`."""
    ahead = Ahead()
    with owned(out) as folder:
        found = diagnose_folder(
            campaign,
            seed=seed,
            quick=quick,
            settings=settings,
            effects_file=effects_file,
            simulator_file=simulator_file,
            progress=progress,
            executor=executor,
            listener=ahead,
        )
        _write(found, folder, effects_file, simulator_file, ahead)
    return found


def write_found(found: Diagnosis, out: Path) -> Path:
    """Write a diagnosis that was made before; returns the page. What `fits.json` then names of a user's own files is
    unknown, so fits with own effects cannot be read back."""
    with owned(out) as folder:
        ahead = Ahead()
        ahead.searched()
        return _write(found, folder, None, None, ahead)


@house_style()
def _write(
    found: Diagnosis,
    folder: Path,
    effects_file: str | Path | None,
    simulator_file: str | Path | None,
    ahead: Ahead,
) -> Path:
    answer, figures = finite(to_dict(found)), diagnosis_figures(found, ahead.figures)
    clear(folder, "diagnosis.json", "diagnosis.html", "fits.json")
    page = write_diagnosis_page(
        answer,
        figures,
        folder / "diagnosis.html",
        effects_described(found),
        found.campaign.units,
        provenance(found.campaign, found.seed),
        {p.name: p.description for p in found.fit.problem.prior.free},
        ahead.renderer,
        effect_viewer_data(found) if found.verdict.causes else None,
    )
    write_answer(found, folder, effects_file, simulator_file)  # last: where it stands, all of them do
    return page


def headline_of(found: Diagnosis) -> Figure:
    """The answer of a diagnosis in one picture."""
    return diagnosis_figures(found)["headline"]
