"""A scored withheld set as files: table, JSON and figures."""

from __future__ import annotations

import json
from pathlib import Path

from bayes_iwan.files import write_whole
from bayes_iwan.gap.saved_fits import find_shrink
from bayes_iwan.report.diagnosis_page import write_figures
from bayes_iwan.report.score_figures import figures
from bayes_iwan.validation.scoring import score


def write_score(
    directory: str | Path, truth: str | Path, *, answers: str | Path | None = None, out: str | Path | None = None
) -> str:
    """Check the seals, score, write `score.txt`, `score.json` and figures into `out` if given; returns the table."""
    result = score(directory, truth, answers=answers, find_shrink=find_shrink)
    table = result.table()
    if out is not None:
        folder = Path(out)
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / "score.txt", table + "\n")
        write_whole(folder / "score.json", json.dumps(result.as_dict(), indent=1) + "\n")
        write_figures(figures(result), folder)
    return table
