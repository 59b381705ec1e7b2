"""A diagnosis as files: `diagnosis.json`, `fits.json`, the page and the figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayes_iwan.files import clear, owned
from bayes_iwan.gap.diagnosis import BASES, Diagnosis, diagnose_folder, write_json
from bayes_iwan.gap.findings import pictures
from bayes_iwan.gap.residuals import residual_of
from bayes_iwan.gap.where import along_cycle
from bayes_iwan.inference.config import Config, diagnose_settings_of
from bayes_iwan.inference.settings import DiagnoseSettings
from bayes_iwan.report import gap_figures
from bayes_iwan.report.diagnosis_page import write_diagnosis_page, write_figures


def diagnosis_figures(found: Diagnosis, answer: dict[str, Any]) -> dict[str, Figure]:
    """Every figure of a diagnosis by name; answer : its `as_dict()`."""
    drawn = pictures(found.residual, found.where, found.before)
    out = gap_figures.figures_of_gap(drawn)
    verdict = answer["verdict"]
    out["probabilities"] = gap_figures.probabilities_figure(answer["probabilities"], verdict["cannot_tell_apart"])
    worst = int(np.argmax(drawn["gap_N"]))
    after = None
    if found.explanations and verdict["cause"] not in ("none", "unknown"):
        lead = found.explanations[0]
        cause = " + ".join(lead.names)
        left = residual_of(found.data, lead.fit)
        after = along_cycle(left, left.value)
        out["before_after"] = gap_figures.before_after_figure(
            drawn["names"], drawn["residual_N"], after, drawn["expected_N"], cause
        )
        out["moved"] = gap_figures.moved_figure(lead.moved)
    out["headline"] = gap_figures.headline_figure(
        answer["probabilities"],
        drawn["names"][worst],
        drawn["residual_N"][worst],
        drawn["expected_N"][worst],
        None if after is None else after[worst],
        "" if after is None else verdict["cause"].replace("_", " "),
    )
    if found.explanations:
        out["shrink"] = gap_figures.shrink_figure(
            [
                (" + ".join(x.names), *x.shrink, None if x.unseen is None else x.unseen.shrink)
                for x in found.explanations
            ]
        )
    return out


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
) -> dict[str, Any]:
    """Diagnose a campaign folder and write everything into `out`; returns what `diagnosis.json` holds.

    base : a name of :data:`bayes_iwan.gap.diagnosis.BASES`; config : TOML file, or its tables, as for `identify`;
    effects_file : a user's own effects; simulator_file : a user's own model in the place of the Iwan model.
    Raises ValueError (and its kinds) with one line that names what is wrong and the mend.
    """
    if base not in BASES:
        raise ValueError(f"--base {base}: not known; choose one of {', '.join(BASES)}")
    if config is not None and base != "generalized":
        raise ValueError(f"--base {base} and --config both choose a model; leave one of them out")
    if simulator_file is not None and base != "generalized":
        raise ValueError(f"--base {base} and --simulator both choose a model; leave one of them out")
    tables = {"model": BASES[base]} if config is None and simulator_file is None else config
    settings = diagnose_settings_of(tables, simulator_file is not None)
    found = write_diagnosis(
        campaign,
        out,
        settings=settings,
        seed=seed,
        quick=quick,
        effects_file=effects_file,
        simulator_file=simulator_file,
        progress=progress,
    )
    return found.as_dict()


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
) -> Diagnosis:
    """Diagnose a campaign folder and write everything into `out`."""
    with owned(out) as folder:
        found, fits = diagnose_folder(
            campaign,
            seed=seed,
            quick=quick,
            config=settings.as_dict(),
            effects_file=effects_file,
            simulator_file=simulator_file,
            progress=progress,
        )
        answer = found.as_dict()
        figures = diagnosis_figures(found, answer)
        clear(folder, "diagnosis.json", "diagnosis.html", "figures", "fits.json")
        write_json(folder / "fits.json", fits)
        write_figures(figures, folder / "figures")
        write_diagnosis_page(answer, figures, folder / "diagnosis.html", found.about())
        write_json(folder / "diagnosis.json", answer)  # last: where it stands, all of them do
    return found
