"""The page of a diagnosis: the answer first, then where, which, how far it shrinks, what moved, what is tied."""

import os
from collections.abc import Mapping
from dataclasses import astuple, dataclass
from pathlib import Path

from matplotlib.figure import Figure

from bayes_iwan.diagnosis.answer import sentences, wording
from bayes_iwan.diagnosis.answer.diagnosis_json import FITTED, INVISIBLE, ceiling_shrink
from bayes_iwan.diagnosis.answer.gap_findings import where_sentences
from bayes_iwan.diagnosis.answer.result import Diagnosis
from bayes_iwan.diagnosis.answer.wording import few, force, interval, percent, plain, title
from bayes_iwan.diagnosis.assessment.budget import Cause
from bayes_iwan.diagnosis.fits.gap_size import Gap, Share
from bayes_iwan.report.page import Page, Provenance, Section
from bayes_iwan.report.rendering import Renderer

Row = tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Diagnosed:
    """What the page of a diagnosis is made from."""

    found: Diagnosis
    figures: Mapping[str, Figure]
    viewer: Mapping[str, object] | None = None


class DiagnosedSection(Section[Diagnosed]):
    template, words, said = "diagnosis.html", wording, sentences


class Answer(DiagnosedSection):
    """The verdict in words, the waterfall, the gap as a sum, where the unexplained part sits, and what words mean."""

    heading = "Answer"

    def parts(self) -> list[Row]:
        verdict, unexplained = self.r.found.verdict, self.r.found.budget.unexplained
        left = "unexplained" + (", cause unknown" if verdict.unknown_cause else "")
        last = (left, f"{unexplained.probability:.2f}", *_share(unexplained.share), "", "", "")
        return [*map(_cause, verdict.causes), last]

    def gaps(self) -> list[Row]:
        return [
            (title(c.name), c.held_out_by or FITTED, *map(percent, (c.gaps.with_all, c.gaps.without, c.gaps.alone)),
             *map(percent, astuple(c.vague)))
            for c in self.r.found.verdict.causes
        ]  # fmt: skip

    @property
    def unexplained_where(self) -> tuple[str, ...]:
        """Nothing where no effect is named: the next section says the same."""
        verdict = self.r.found.verdict
        return self.r.found.budget.unexplained.where if verdict.unknown_cause and verdict.causes else ()


def _share(share: Share | None) -> tuple[str, str]:
    return ("–", "–") if share is None else (percent(share.value), interval((share.low, share.high), percent))


def _cause(c: Cause) -> Row:
    tied = few(c.tied_with) if c.tied_with else "–"
    return title(c.name), f"{c.probability:.2f}", *_share(c.share), *_share(c.held_out), tied


class Where(DiagnosedSection):
    """The gap whatever its causes."""

    heading = "Where the model misses"

    @property
    def sentences(self) -> list[str]:
        return where_sentences(self.r.found.where)

    def tests(self) -> list[Row]:
        """Head and rows; without a clock no frequency."""
        found, w = self.r.found, self.r.found.where

        def size(gap: Gap) -> Row:
            return force(gap.rms_N), interval((gap.low_N, gap.high_N), force), percent(gap.share)

        head = ("test", "frequency, Hz", "amplitude, mm", "gap (RMS)", "90 % interval", "share of friction")
        rows = [
            (file, f"{f:.3g}", f"{a:.3g}", *size(gap), _yes(out))
            for file, f, a, gap, out in zip(w.files, w.frequency_hz, w.amplitude_mm, found.before.tests, w.stands_out)
        ]
        every = [(*head, "stands out"), ("all tests", "", "", *size(found.budget.before), ""), *rows]
        return every if found.campaign.clock else [(row[0], *row[2:]) for row in every]

    def regions(self) -> list[Row]:
        some = self.r.found.where.of("region")
        return [(x.name, force(x.gap_N), percent(x.share), percent(x.time), _yes(x.significant)) for x in some]

    def harmonics(self) -> list[Row]:
        both = zip(self.r.found.where.of("in phase"), self.r.found.where.of("quadrature"))
        return [
            (str(order), force(p.gap_N), force(q.gap_N), _yes(p.significant or q.significant))
            for order, (p, q) in enumerate(both, start=1)
        ]


class Which(DiagnosedSection):
    heading = "Which cause"

    def numbers(self, cause: str) -> list[Row]:
        return [
            (name, plain(x.mean, 4), plain(x.sd, 4), f"{plain(x.q05, 4)} to {plain(x.q95, 4)}", x.unit)
            for name, x in self.r.found.parameters[cause].items()
        ]

    def considered(self) -> list[Row]:
        places = {f.name: f for f in self.r.found.found.figures}
        rows: list[Row] = []
        for name in sentences.not_excluded(self.r.found):
            x = places.get(name)
            cells = ("–",) * 2 if x is None else (percent(x.fitted), percent(x.held_out))
            rows.append((title(name), f"{self.r.found.verdict.probabilities[name]:.2f}", *cells))
        return rows

    @property
    def failed(self) -> list[Row]:
        return [(title(name), why) for name, why in self.r.found.search.failed.items()]


class HowFar(DiagnosedSection):
    heading, ceiling = "How far the gap shrinks", staticmethod(ceiling_shrink)

    @property
    def after(self) -> str:
        """The gap that the named effects leave."""
        after = self.r.found.budget.after
        return force(after.rms_N) if after.low_N > 0.0 else "nothing beyond noise"


class Moved(DiagnosedSection):
    heading = "How the identified parameters moved"

    def rows(self) -> list[Row]:
        meanings = {p.name: p.description for p in self.r.found.fit.problem.prior.free}
        return [
            (n, plain(m.before, 4), plain(m.after, 4), plain(m.sd, 4), m.unit, meanings.get(n, "–"))
            for n, m in self.r.found.moved.items()
        ]


class CannotTell(DiagnosedSection):
    heading, invisible = "What these tests cannot tell", INVISIBLE

    def imitated(self) -> list[Row]:
        return [
            (x.what, title(e.name), _yes(e.name in x.tied), percent(x.without), percent(e.share))
            for x in self.r.found.imitations
            for e in x.explanations
        ]

    def edges(self) -> list[Row]:
        return [(x.name, plain(x.value, 4), x.unit, f"{x.deviations:+.1f}", x.prior) for x in self.r.found.edges]

    def benches(self) -> list[Row]:
        verdict = self.r.found.verdict
        asked = {n for c in verdict.causes for n in (c.name, *c.tied_with)}.union(*(x.names for x in verdict.one_of))
        effects = {n: laws[0] for n, laws in self.r.found.search.effects.items() if n in asked}
        return [(title(n), e.bench) for n, e in effects.items() if e.bench]


class Settings(DiagnosedSection):
    heading = "Settings and definitions"

    def rows(self) -> list[Row]:
        found, whole, parts = self.r.found, self.r.found.budget.before, self.r.found.before
        sizes_N = {
            "residual, RMS, noise included": whole.residual_N,
            "noise, RMS": whole.noise_N,
            "gap in the averaged loops": parts.loop.rms_N,
            "gap along the records": parts.along.rms_N,
            "gap by mains interference": parts.mains.rms_N,
            "gap of the mean forces (not counted)": parts.mean.rms_N,
        }
        rows = [("seed", str(found.seed)), ("quick run", _yes(found.quick))]
        rows += [(label, force(size_N)) for label, size_N in sizes_N.items()]
        return [*rows, *((f"model: {k}", str(v)) for k, v in found.settings.as_dict()["model"].items())]


def _yes(yes: bool) -> str:
    return "yes" if yes else "no"


def write_diagnosis_page(
    found: Diagnosis,
    figures: Mapping[str, Figure],
    path: str | os.PathLike[str],
    made: Provenance | None = None,
    renderer: Renderer | None = None,
    viewer: Mapping[str, object] | None = None,
) -> Path:
    """Write the page; whole or not at all.

    figures : by name; those missing are omitted; made : from what and when; viewer : of
    :func:`bayes_iwan.report.viewer.effect_viewer_data`.
    """
    subtitle = "What the model misses, what makes it, what is left and the next test"
    footer, units = "Every number here is in diagnosis.json.", found.campaign.units
    page = Page(f"Diagnosis: {found.campaign.name}", subtitle, footer, units, made, renderer)
    r = Diagnosed(found=found, figures=figures, viewer=viewer)
    page.add(Answer(r), Where(r), Which(r), HowFar(r), Moved(r), CannotTell(r), Settings(r))
    return page.write(path)
