"""A scored withheld set as files: table, JSON and figures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from bayes_iwan.diagnosis.answer.saved_fits import find_shares
from bayes_iwan.files import write_whole
from bayes_iwan.report.style import save
from bayes_iwan.report.withheld.score_figures import figures
from bayes_iwan.withheld.scoring import score


def _share(folder: Path, sealed: Path, cause: str, *, allow_own_files: bool) -> float | None:
    return find_shares(folder, sealed, allow_own_files=allow_own_files)[1].get(cause)


def write_score(
    directory: str | Path,
    truth: str | Path,
    *,
    answers: str | Path | None = None,
    out: str | Path | None = None,
    allow_effects_file: bool = False,
    excluded: Sequence[str] = (),
) -> str:
    """Check the seals, score, write `score.txt`, `score.json` and figures into `out` if given; returns the table and,
    case by case, what was true and what was said."""
    result = score(
        directory,
        truth,
        answers=answers,
        find_shrink=partial(_share, allow_own_files=allow_effects_file),
        allow_effects_file=allow_effects_file,
        excluded=excluded,
    )
    table = result.table() + "\n\n" + result.case_table()
    if out is not None:
        folder = Path(out)
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / "score.txt", table + "\n")
        write_whole(folder / "score.json", json.dumps(result.as_dict(), indent=1) + "\n")
        for name, figure in figures(result).items():
            for kind in ("png", "svg"):
                save(figure, folder / f"{name}.{kind}")
    return table
