"""The diagnosis of one campaign: the gap as a budget of named causes and an unexplained part."""

import os
import re
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Campaign, Loop, read_campaign
from bayes_iwan.campaign.loops.averaging import fitted_loops
from bayes_iwan.campaign.loops.clipping import limits_of_loops
from bayes_iwan.diagnosis.answer.diagnosis_json import write_answer
from bayes_iwan.diagnosis.answer.gap_findings import where_sentences
from bayes_iwan.diagnosis.answer.imitation import edges_of, imitations, said_in_text
from bayes_iwan.diagnosis.answer.localisation import Located, located, where
from bayes_iwan.diagnosis.answer.next_test import TESTABLE_NATS, NextTest, next_test, visible_nats
from bayes_iwan.diagnosis.answer.result import Diagnosis, EffectParameter, Moved
from bayes_iwan.diagnosis.answer.saved_fits import loops_of
from bayes_iwan.diagnosis.assessment.assessed_search import Weighed, weighed
from bayes_iwan.diagnosis.assessment.budget import NO_CAUSE, GapBudget, Kind, Unexplained, Verdict, unexplained_share
from bayes_iwan.diagnosis.assessment.calibration import Calibration, calibration
from bayes_iwan.diagnosis.assessment.sampled_fit import sampled_fit
from bayes_iwan.diagnosis.assessment.verdict import candidates_of, refused, resembled, verdict_of
from bayes_iwan.diagnosis.constants import MOST_EFFECTS
from bayes_iwan.diagnosis.fits.data import GapData, gap_data
from bayes_iwan.diagnosis.fits.evidence import Fit, base_model
from bayes_iwan.diagnosis.fits.gap_size import Share
from bayes_iwan.diagnosis.fits.residuals import residual_of
from bayes_iwan.diagnosis.search.fitted_sets import Report, silent
from bayes_iwan.diagnosis.search.model_search import search
from bayes_iwan.diagnosis.search.search_result import Search
from bayes_iwan.effects import catalogue
from bayes_iwan.effects.base import Effect
from bayes_iwan.effects.catalogue import load_effects
from bayes_iwan.effects.conditions import conditions_of
from bayes_iwan.effects.paper_stages import missing_terms
from bayes_iwan.errors import nearest
from bayes_iwan.executors import Workers, opened
from bayes_iwan.former_names import refuse_former_options
from bayes_iwan.inference.setup.config import Config, ConfigError, diagnose_settings_of
from bayes_iwan.inference.setup.loop_scales import Scales, scales_of
from bayes_iwan.inference.setup.settings import DiagnoseSettings, ModelSettings
from bayes_iwan.models import Simulator
from bayes_iwan.models.user_file import load_simulator
from bayes_iwan.terminal import plain
from bayes_iwan.threads import linear_algebra

#: models to start from, by name
BASES: dict[str, ModelSettings] = {
    "generalized": ModelSettings(),
    "no_speed": ModelSettings(normal_force="hunt_crossley_no_speed"),
    "classical": ModelSettings(normal_force="constant", stiffness="constant"),
}
#: what processes that refit import as they start
NEEDS = (__name__,)
#: draws behind the intervals of an effect's parameters
DRAWS = 2000
#: a cause whose probability lies between these is still in question
OPEN = (0.1, 0.9)


@refuse_former_options
def diagnose_loops(
    campaign: Campaign,
    loops: Sequence[Loop],
    *,
    seed: int = 0,
    quick: bool = False,
    settings: DiagnoseSettings | None = None,
    extra: Sequence[type[Effect]] = (),
    simulator: Simulator | None = None,
    constants: Calibration | None = None,
    report: Report = silent,
    workers: Workers = None,
) -> Diagnosis:
    """Diagnose averaged loops. The answer does not depend on how many processes or threads there are.

    Parameters
    ----------
    campaign
        where they are from: its name and units.
    loops
        tests with role "held-out" are not fitted, only predicted.
    seed, quick, simulator, workers
        as for :func:`bayes_iwan.diagnose`.
    settings
        the base model and its priors.
    extra
        effects of a user's own.
    constants
        another calibration than the shipped one.
    report
        called as the search goes on.

    Returns
    -------
    Diagnosis
        verdict, budget of the gap, next test.

    Raises
    ------
    InputError
        no test is left to fit.

    Examples
    --------
    >>> import tempfile, bayes_iwan as bi
    >>> folder = tempfile.mkdtemp()
    >>> bi.simulate_campaign([bi.PlannedTest(10.0, a, cycles=6) for a in (0.4, 0.9)], seed=1).write(folder)
    >>> read = bi.check(folder)
    >>> bi.diagnose_loops(read.campaign, read.loops, seed=1, quick=True).verdict.names
    ()
    """
    settings = settings or DiagnoseSettings()
    if not campaign.clock and simulator is None:
        settings = replace(settings, model=settings.model.without_speed)
    fitted = list(fitted_loops(loops))
    held_out = [x for x in loops if x.role == "held-out"]
    # with more threads sums are rounded otherwise, and a search ends elsewhere
    with opened(workers, along=True, needs=NEEDS) as executor, linear_algebra().limit(limits=1):
        data = gap_data(fitted)
        search = searched(data, settings, seed, extra, simulator, report, executor)
        gap = located(campaign, search, seed)
        found = weighed(search, seed)
        report("weighing causes")
        verdict = verdict_of(found, constants or calibration(), held_out)
        return _reported(gap, seed, quick, settings, found, verdict, constants or calibration(), report)


def searched(
    data: GapData,
    settings: DiagnoseSettings,
    seed: int,
    extra: Sequence[type[Effect]] = (),
    simulator: Simulator | None = None,
    report: Report = silent,
    executor: Executor | None = None,
) -> Search:
    """The search over all effects of the catalogue, patterns without a cause, a user's own, and terms of the paper that
    the base model lacks."""
    scales = scales_of(data.loops)
    base = base_model(settings, scales) if simulator is None else simulator
    kinds = offered_effects(data, base, extra)
    if not data.loops[0].record.clock:
        kinds = {n: some for n, some in kinds.items() if not _clocked(some)}
    rng = np.random.default_rng([seed, 1])
    most = MOST_EFFECTS + len(missing_terms(base))
    return search(data, scales, settings, kinds, rng, report, most, base, executor)


def offered_effects(
    data: GapData, base: Simulator, extra: Sequence[type[Effect]] = ()
) -> dict[str, tuple[catalogue.Maker, ...]]:
    """What makes the effects on offer, by name."""
    conditions = conditions_of([x.extras for x in data.loops])
    return catalogue.variants(extra, base, conditions) | {k.name: (k,) for k in catalogue.unlisted(base)}


def _clocked(some: Sequence[catalogue.Maker]) -> bool:
    """Does an effect need real times?"""
    return any(getattr(k, "needs_clock", False) for k in some)


def _needing_clock(settings: DiagnoseSettings, data: GapData, scales: Scales) -> tuple[str, ...]:
    """Listed effects that records without a clock cannot show."""
    kinds = offered_effects(data, base_model(settings, scales))
    return tuple(n for n, some in kinds.items() if _clocked(some) and n not in NO_CAUSE)


def _reported(
    gap: Located,
    seed: int,
    quick: bool,
    settings: DiagnoseSettings,
    found: Weighed,
    verdict: Verdict,
    constants: Calibration,
    report: Report,
) -> Diagnosis:
    """Everything that is said beside the verdict."""
    base, named, data = found.models.fits[frozenset()], frozenset(verdict.names), found.search.data
    fit, after = found.models.fits[named], found.models.sizes[named]
    sampling = None
    if named and not quick:  # of a model without effects no number is reported
        fit, sampling = sampled_fit(data, fit, seed, report)
    left = residual_of(data, found.models.nearest[named])
    places = where_sentences(gap.where if not named else where(left, seed)) if verdict.unknown_cause else []
    pattern = resembled(found.figures) if verdict.unknown_cause else None
    unexplained = Unexplained(
        verdict.probabilities["unknown"],
        unexplained_share(named, found.models.sizes) if named else Share(1.0, 1.0, 1.0),
        after.all.share,
        tuple(places),
        None if pattern is None else pattern.name,
        0.0 if pattern is None else pattern.fitted,
    )
    rng = np.random.default_rng([seed, 2])
    nats = visible_nats(data, base, found.search.effects)
    shown = {n for n, v in nats.items() if v >= TESTABLE_NATS and not found.search.effects[n][0].flexible}
    hidden = tuple(n for n in nats if n not in shown | named | NO_CAUSE)
    report("what the base can imitate")
    friction_N = float(np.sqrt(np.mean(gap.size.friction_N**2)))
    imitated = imitations(found.search, found.models.fits, named, friction_N, gap.campaign.limits)
    if verdict.kind is Kind.DRIVE:
        imitated = ()
    report("next test")
    following = _next(data, found, verdict, constants, gap.campaign)
    if following is None or not (named or verdict.one_of):  # what is said comes before what is only possible
        open_ones = (x.next_test for x in said_in_text(imitated) if not named & {*x.tied})
        following = next((test for test in open_ones if test), following)
    return Diagnosis(
        gap.campaign,
        seed,
        quick,
        settings,
        data,
        found,
        verdict,
        GapBudget(gap.size.all, after.all, verdict.causes, unexplained),
        gap.size,
        gap.residual,
        gap.where,
        left,
        _parameters(fit, data, rng),
        _moved(base, fit, rng) if named else {},
        hidden,
        {n: v for n, v in nats.items() if n not in NO_CAUSE},
        imitated,
        edges_of(found.models.fits[named]),
        limits_of_loops([x.record for x in data.loops], data.loops),
        () if gap.campaign.clock else _needing_clock(settings, data, found.search.scales),
        following,
        sampling,
    )


def _draws(fit: Fit, rng: np.random.Generator, count: int) -> dict[str, Array]:
    """Values of every parameter, (count,), from a fit's normal approximation."""
    root = np.linalg.cholesky(fit.covariance)
    return fit.problem.prior.values(fit.z + rng.standard_normal((count, len(fit.z))) @ root.T)


def _parameters(fit: Fit, data: GapData, rng: np.random.Generator) -> dict[str, dict[str, EffectParameter]]:
    """Parameters of every effect of a fit as reported, what it does within the records before them; nature's law is not
    quite ours, and that counts."""
    values, clock = _draws(fit, rng, DRAWS), data.loops[0].record.clock
    out: dict[str, dict[str, EffectParameter]] = {}
    for effect in fit.effects:
        law = 1.0 + effect.law_error * rng.standard_normal(DRAWS)
        numbers = effect.within(values, data.block_motion) | effect.reported(values)
        out[effect.name] = {
            n: _estimate(v * law, unit if clock else in_cycles(unit)) for n, (v, unit) in numbers.items()
        }
    return out


def in_cycles(unit: str) -> str:
    """A unit of records without a clock, of which every cycle lasts a second: "cycles" for "s"."""
    return re.sub(r"\bs\b", "cycles", unit)


def _estimate(values: Array, unit: str) -> EffectParameter:
    low, high = np.quantile(values, [0.05, 0.95])
    return EffectParameter(float(np.mean(values)), float(np.std(values)), float(low), float(high), unit)


def _moved(base: Fit, fit: Fit, rng: np.random.Generator) -> dict[str, Moved]:
    """How the specimen's own parameters change once the causes are in, and by how many standard deviations."""
    without, with_them = _draws(base, rng, 400), _draws(fit, rng, 400)
    return {
        p.name: Moved(
            float(np.median(without[p.name])),
            float(np.median(with_them[p.name])),
            float(np.hypot(without[p.name].std(), with_them[p.name].std())),
            p.unit,
        )
        for p in base.problem.prior.free
    }


def _next(
    data: GapData, found: Weighed, verdict: Verdict, constants: Calibration, campaign: Campaign
) -> NextTest | None:
    """The test that best settles what is still in question: a cause and its nearest alternative, or whether a cause is
    there at all; None where nothing is, or where the drive must be fixed first. What something speaks against is in
    question only where it is one of those that are said to contribute."""
    if verdict.kind is Kind.DRIVE:
        return None
    whole, said = frozenset(found.search.chosen), {n for x in verdict.one_of for n in x.names}
    spoken_of = said.union(verdict.names)
    for f in sorted(found.figures, key=lambda f: -f.moved):
        others = [n for n in candidates_of(f, constants) if n != f.name]
        open_question = OPEN[0] < verdict.probabilities.get(f.name, 0.0) < OPEN[1]
        tied = others and f.name in spoken_of
        if (refused(f) and f.name not in said) or not (tied or open_question):
            continue
        other = others[0] if others else "none"
        fits = found.search.fit(whole), found.search.fit(whole - {f.name} | {*others[:1]})
        effects = found.search.effects
        bench = [effects[n][0].bench for n in (f.name, other) if n in effects]
        return next_test(data, *fits, (f.name, other), bench, campaign.limits)
    return None


def settings_for(base: str, config: DiagnoseSettings | Config, own_simulator: bool) -> DiagnoseSettings:
    """Settings of a diagnosis; base : a name of :data:`BASES`. Raises ConfigError where two of them choose a model."""
    if base not in BASES:
        raise ConfigError(f"base {base!r} is not known{nearest(base, BASES)}")
    for given, what in ((config is not None, "config"), (own_simulator, "simulator")):
        if given and base != "generalized":
            raise ConfigError(f"base {base} and {what} both choose a model; leave one of them out")
    return diagnose_settings_of(DiagnoseSettings(BASES[base]) if config is None else config, own_simulator)


def diagnose_campaign(
    campaign: Campaign | str | os.PathLike[str],
    *,
    config: DiagnoseSettings | Config = None,
    seed: int = 0,
    quick: bool = False,
    base: str = "generalized",
    effects: Sequence[type[Effect]] | str | os.PathLike[str] = (),
    simulator: Simulator | str | os.PathLike[str] | None = None,
    progress: bool = True,
    workers: Workers = None,
) -> Diagnosis:
    """Diagnose a campaign, or its folder.

    effects, simulator : a user's own, as classes and an object, or the Python files that define them, which are run;
    all else as for :func:`bayes_iwan.diagnose` and :func:`diagnose_loops`.
    """
    settings = settings_for(base, config, simulator is not None)
    read = campaign if isinstance(campaign, Campaign) else read_campaign(campaign)
    extra = load_effects(effects) if isinstance(effects, str | os.PathLike) else tuple(effects)
    model = load_simulator(simulator) if isinstance(simulator, str | os.PathLike) else simulator
    with tqdm(desc=plain(read.name), disable=None if progress else True, unit=" fits", leave=False) as bar:

        def report(stage: str) -> None:
            bar.set_postfix_str(stage)
            bar.update()

        return diagnose_loops(
            read, loops_of(read), seed=seed, quick=quick, settings=settings, extra=extra, simulator=model,
            report=report, workers=workers,
        )  # fmt: skip


def diagnose_case(campaign: str | Path, out: str | Path, seed: int = 0, quick: bool = False) -> dict[str, object]:
    """Diagnose and write `diagnosis.json` and `fits.json` only: what the withheld protocol asks for."""
    return write_answer(diagnose_campaign(campaign, seed=seed, quick=quick), Path(out))
