"""How good a set of answers is: answers against truths whose seals were checked, each figure with an interval."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from bayes_iwan.files import finite
from bayes_iwan.virtual_rig.faults import CATALOGUE
from bayes_iwan.withheld.answers import read_answer
from bayes_iwan.withheld.case_score import CaseScore, score_case
from bayes_iwan.withheld.estimates import Estimate, findable
from bayes_iwan.withheld.metrics import by_law, by_outside, confusion, summarise
from bayes_iwan.withheld.sealed import WithheldError, check_sealed, check_seals, read_json, read_truths, sealed_tests
from bayes_iwan.withheld.truths import read_truth

FindShares = Callable[[Path, Path], Mapping[str, float]]


@dataclass(frozen=True)
class Score:
    """A scored set: its cases, its table, and what the table leaves out.

    `faulty`: cases whose rig had a law that no specimen has, not in `cases`. `held_back`: the table of those cases
    alone whose laws or outside kinds were not used in calibration. `findable_visible`: visible size over noise of
    single effects that half, and 80 %, are found at. `notes`: what a reader must know.
    """

    cases: tuple[CaseScore, ...]
    faulty: tuple[CaseScore, ...]
    summary: Mapping[str, Estimate]
    held_back: Mapping[str, Estimate]
    findable_visible: Mapping[float, Estimate]
    notes: tuple[str, ...] = ()

    def table(self) -> str:
        """The score as text, one line a figure; the held-back cases' values beside it."""
        width = max(len(k) for k in self.summary)
        lines = []
        if self.held_back:
            lines.append(" " * (width + 2) + f"{'these answers':34s}{'excluded from calibration':>26s}")
        for key, figure in self.summary.items():
            line = f"{key:{width}s}  {figure.text():34s}"
            if self.held_back:
                seen = self.held_back.get(key)
                line += f"{'' if seen is None or seen.n == 0 else f'{seen.brief()} (n = {seen.n})':>26s}"
            lines.append(line.rstrip())
        for target, figure in self.findable_visible.items():
            label = f"visible size over noise found in {100 * target:.0f} % of single cases"
            said = figure.text() if np.isfinite(figure.value) else "not within those tried"
            lines.append(f"{label:{width}s}  {said}")
        lines += _split_lines("by law (visible listed causes)", ("named", "or in the set"), by_law(self.cases))
        heads = ("unknown cause flagged", "a false name")
        lines += _split_lines("by outside kind (visible)", heads, by_outside(self.cases))
        if self.faulty:
            lines.append("counted apart: cases of a law that no specimen has")
            lines += [f"  {c.name}: {', '.join(k.name for k in c.truth.causes)}: {_said(c)}" for c in self.faulty]
        missing = [c.name for c in self.cases if not c.answered]
        if missing:
            lines.append(f"not answered, scored as a verdict of none with every probability 0.5: {', '.join(missing)}")
        return "\n".join((*lines, *self.notes))

    def case_table(self) -> str:
        """One line a case: truth, verdict, causes named."""
        return "\n".join(
            f"{c.name}  {c.kind:22s} {', '.join(k.name for k in c.truth.causes) or '-':44s} {_said(c)}"
            for c in self.cases
        )

    def as_dict(self) -> dict[str, object]:
        """Plain numbers for JSON; nan becomes None."""
        rows, columns, counts = confusion(self.cases)
        out = {
            "schema": 2,
            "summary": self.summary,
            "excluded_from_calibration": self.held_back,
            "findable_visible": self.findable_visible,
            "by_law": by_law(self.cases),
            "by_outside": by_outside(self.cases),
            "confusion": {"truth": rows, "verdict": columns, "counts": counts.astype(int).tolist()},
        }
        cases = {n: list(map(_case, some)) for n, some in (("cases", self.cases), ("faulty", self.faulty))}
        return dict(finite(out | cases | {"notes": self.notes}))


def _said(c: CaseScore) -> str:
    if not c.answered:
        return "not answered"
    return c.answer.kind + "".join(f", {n.name} {n.probability:.2f}" for n in c.answer.causes)


def _split_lines(title: str, heads: tuple[str, str], parts: Mapping[str, tuple[Estimate, Estimate]]) -> list[str]:
    if not parts:
        return []
    lines = [f"{title:44s} {heads[0]:34s} {heads[1]}"]
    return lines + [f"  {label:42s} {first.text():34s} {second.text()}" for label, (first, second) in parts.items()]


def _case(c: CaseScore) -> dict[str, object]:
    return {
        "name": c.name,
        "kind": c.kind,
        "causes": [asdict(k) | {"seen": c.truth.seen(k), "listed": k.listed} for k in c.truth.causes],
        **{n: getattr(c.truth, n) for n in ("noise", "frequencies", "family")},
        "verdict": c.answer.kind,
        "named": [{"name": n.name, "probability": n.probability, "share": n.share} for n in c.answer.causes],
        "tied_with": sorted(c.answer.in_sets - c.answer.names),
        "unknown_cause": c.answer.unknown_cause,
        **{n: getattr(c, n) for n in ("found", "in_set")},
        "false_names": sorted(c.false_names),
        **{n: getattr(c, n) for n in ("log_score", "brier", "answered")},
    }


def score_answers(
    truths: Mapping[str, Mapping[str, object]],
    answers: Mapping[str, Mapping[str, object]],
    *,
    found: Mapping[str, Mapping[str, float]] | None = None,
    excluded: Sequence[str] = (),
    notes: Sequence[str] = (),
) -> Score:
    """Score answers against truths whose seals have been checked.

    Parameters: both by case name; `found`, by case and cause, shares of the gap found on sealed tests; `excluded`, laws
    ("name:law") and outside kinds that calibration never saw: their cases get a table of their own beside. Raises
    `WithheldError` for answers without a truth, and for answers that are refused.
    """
    strange = sorted(set(answers) - set(truths))
    if strange:
        raise WithheldError(f"answers to cases that have no truth: {', '.join(strange)}")
    read = {name: read_truth(name, truths[name]) for name in sorted(truths)}
    shares = found or {}
    everything = [score_case(name, true, answers.get(name), shares.get(name)) for name, true in read.items()]
    cases = tuple(c for c in everything if not c.truth.faulty)
    new = [c for c in cases if any(k.name in excluded or f"{k.name}:{k.law}" in excluded for k in c.truth.causes)]
    single = [c for c in cases if c.kind == "single" and c.truth.noise > 0 and c.truth.causes[0].visible > 0]
    sizes, faulty = (
        [c.truth.causes[0].visible / c.truth.noise for c in single],
        [c for c in everything if c.truth.faulty],
    )
    visible = findable(sizes, [c.found for c in single])
    held_back = summarise(new) if new else {}
    return Score(cases, tuple(faulty), summarise(cases), held_back, visible, tuple(notes))


def read_answers(path: Path) -> dict[str, dict[str, object]]:
    """Answers by case from {"answers": {case: diagnosis}} or {case: diagnosis}. Raises `WithheldError`."""
    content = read_json(path)
    given = content.get("answers", content) if isinstance(content, dict) else None
    if not isinstance(given, dict) or not all(isinstance(a, dict) for a in given.values()):
        raise WithheldError(f"{path}: no answers in it")
    return given


def score(
    directory: Path | str,
    truth: Path | str,
    *,
    answers: Path | str | None = None,
    find_shares: FindShares | None = None,
    allow_effects_file: bool = False,
    excluded: Sequence[str] = (),
) -> Score:
    """Check the commitments, then score `answers.json` (by default `directory/answers/answers.json`).

    Answers are {"answers": {case: diagnosis}} or {case: diagnosis}. `find_shares(diagnosis_folder, sealed_campaign)`
    predicts the sealed tests with the diagnosed model, with and without each named cause, and returns the share of the
    gap that each removes there; it is called for every case with a sealed campaign in the folder of truths that names a
    cause. Where `fits.json` names a file of the answerer's own effects or simulator, that code is run only if
    `allow_effects_file`; else such cases have no share on sealed tests, and the table says so. Raises `WithheldError`
    if a seal is broken.
    """
    directory, truth = Path(directory), Path(truth)
    answers_path = Path(answers) if answers is not None else directory / "answers" / "answers.json"
    truths = read_truths(truth)
    check_seals(directory, truths)
    given = read_answers(answers_path)
    found: dict[str, dict[str, float]] = {}
    foreign = []
    for name in sorted(set(given) & set(truths)):
        sealed, fits = sealed_tests(truth, name), answers_path.parent / name / "fits.json"
        if find_shares is None or not (sealed / "campaign.toml").is_file() or not fits.is_file():
            continue
        check_sealed(name, sealed, truths[name])
        if _names_code(fits) and not allow_effects_file:
            foreign.append(name)
            continue
        if named := read_answer(name, given[name]).names & set(CATALOGUE):
            values = find_shares(fits.parent, sealed)
            found[name] = {k: float(v) for k, v in values.items() if k in named and np.isfinite(v)}
    notes = []
    if foreign:
        notes.append(
            f"not tried on sealed tests, since fits.json names code of the answerer's own (run it with "
            f"--allow-effects-file): {', '.join(foreign)}"
        )
    return score_answers(truths, given, found=found, excluded=excluded, notes=notes)


def _names_code(fits: Path) -> bool:
    """Whether a `fits.json` names a Python file that predicting with it would run."""
    stored = read_json(fits)
    return isinstance(stored, dict) and bool(stored.get("effects_file") or stored.get("simulator_file"))
