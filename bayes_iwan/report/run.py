"""Reports from what stands in a folder: the doors behind `bayes-iwan report` and `bayes-iwan compare`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from bayes_iwan.comparison.families import Comparison, compare_families
from bayes_iwan.comparison.frequencies import compare_frequencies
from bayes_iwan.files import clear, owned
from bayes_iwan.inference.results import load
from bayes_iwan.report.comparison import comparison_report
from bayes_iwan.report.identification import identification_report


def report_run(
    folder: str | os.PathLike[str],
    *,
    campaign: str | os.PathLike[str] | None = None,
    pdf: bool = False,
    per_frequency: bool = False,
    simulator: str | os.PathLike[str] | None = None,
) -> Path:
    """report.html (and report.pdf) of a folder that `identify` wrote; returns the page's path.

    campaign : the campaign's folder if it has moved. simulator : the Python file of the model of one's own that was
    identified; its code is run. per_frequency : identify each frequency alone by short runs
    where the folder has no per_test results; else quick estimates stand in.
    """
    posterior = load(folder, campaign, simulator)
    with owned(folder) as out:
        found = compare_frequencies(posterior, out, run=per_frequency)
        clear(out, "report.html", "report.pdf", "tables")
        return identification_report(posterior, out, by_frequency=found, pdf=pdf)


def compare_campaign(
    campaign: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    families: Sequence[str] | None = None,
    config: Mapping[str, Any] | str | os.PathLike[str] | None = None,
    seed: int = 0,
    by: str = "auto",
    executor: Executor | None = None,
    progress: bool = True,
) -> Comparison:
    """Fit families to a campaign, rank them, write out/compare.html and out/compare.csv."""
    with owned(out) as folder:
        result = compare_families(
            campaign, families, config=config, seed=seed, by=by, executor=executor, progress=progress
        )
        clear(folder, "compare.html", "compare.csv")
        comparison_report(result, folder)
    return result
