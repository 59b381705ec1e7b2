"""The diagnosis of one campaign: where the model misses, which cause, how far the gap shrinks; `diagnosis.json`."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm.auto import tqdm

from bayes_iwan.campaign import Campaign, Loop, read_campaign
from bayes_iwan.effects import catalogue
from bayes_iwan.effects.base import Effect
from bayes_iwan.effects.conditions import conditions_of
from bayes_iwan.effects.paper import missing_terms
from bayes_iwan.effects.user_file import load_effects
from bayes_iwan.files import write_whole
from bayes_iwan.gap.attribution import Attribution, Table, attribute, best_fit, calibration, doubted
from bayes_iwan.gap.data import GapData, gap_data
from bayes_iwan.gap.evidence import Fit
from bayes_iwan.gap.findings import where_json
from bayes_iwan.gap.gap_size import GapSize, ceiling_N, gap_size, moved_shares, shrink
from bayes_iwan.gap.leave_out import Unseen, unseen_gap
from bayes_iwan.gap.next_test import TESTABLE_NATS, NextTest, next_test, visible_nats
from bayes_iwan.gap.paper_terms import Terms, select_terms
from bayes_iwan.gap.residuals import Residual, residual_of
from bayes_iwan.gap.sample_fit import sampled_fit
from bayes_iwan.gap.saved_fits import LOOPS, stored_fits
from bayes_iwan.gap.search import Search, search
from bayes_iwan.gap.where import Where, where
from bayes_iwan.gap.words import beyond_sentence, sentences
from bayes_iwan.inference.scales import Scales, scales_of
from bayes_iwan.inference.user_file import load_simulator
from bayes_iwan.physics import Model, Simulator
from bayes_iwan.terminal import plain

#: models to start from, by name, as the [model] table of a configuration
BASES: dict[str, dict[str, str]] = {
    "generalized": {},
    "no_speed": {"grip": "hunt_crossley_no_speed"},
    "classical": {"grip": "constant", "stiffness": "constant"},
}
#: what no loop test can see, whatever the cause
UNSEEN_BY_ALL = (
    "A gain error of the displacement channel is absorbed whole by the stiffnesses, one of the force "
    "channel by stiffnesses and slip forces together: no loop test can see either. Check both against a "
    "known spring."
)
#: probability above which another cause is reported in full beside the leader
WORTH_REPORTING = 0.02
#: a named cause must shrink a gap of at least this share of the friction force by so much, or it is none
JUDGED_SHARE, LEAST_SHRINK, LEAST_FITTED_SHRINK, LEAST_HELP = 0.008, 0.25, 0.6, 0.1
#: draws behind the intervals of an effect's numbers
DRAWS = 2000


@dataclass(frozen=True)
class Explanation:
    """One leading cause (with its second, if named): its fit, its numbers, and what it leaves of the gap."""

    names: tuple[str, ...]
    fit: Fit
    parameters: dict[str, dict[str, dict[str, Any]]]
    after: GapSize
    shrink: tuple[float, float, float]
    unseen: Unseen | None
    moved: dict[str, dict[str, Any]]
    log_evidence: float

    @property
    def predicts(self) -> bool:
        """Are its numbers the same in every test? Those of a hum belong to single records and predict no other."""
        return all(e.strength_name in self.fit.problem.names for e in self.fit.effects)

    @property
    def shrink_expected(self) -> float:
        """On further tests like these. Leaving a whole frequency out asks for more: that the rest tell of it."""
        return self.shrink[0] if self.predicts or self.unseen is None else self.unseen.shrink


@dataclass(frozen=True)
class Diagnosis:
    """Everything that was found; :meth:`as_dict` is what `diagnosis.json` holds.

    terms, beyond : where the base model lacks terms of the paper that the campaign needs: these terms, which are then
    the cause, and the diagnosis of what remains with all of them in.
    """

    campaign: Campaign
    seed: int
    quick: bool
    config: dict
    data: GapData
    found: Search
    attribution: Attribution
    residual: Residual
    before: GapSize
    where: Where
    explanations: tuple[Explanation, ...]
    not_testable: tuple[str, ...]
    expected_nats: dict[str, float]
    next_test: NextTest | None
    terms: Terms | None = None
    beyond: Diagnosis | None = None

    def as_dict(self) -> dict[str, Any]:
        """The schema of `diagnosis.json`."""
        a = self.attribution
        out: dict[str, Any] = {
            "schema": 1,
            "seed": self.seed,
            "quick": self.quick,
            "campaign": self.campaign.name,
            "base": self.config.get("model", {}),
            "verdict": {
                "cause": a.cause,
                "probability": a.probability,
                "cannot_tell_apart": list(a.cannot_tell_apart),
                "second_cause": a.second_cause,
                "not_testable": list(self.not_testable),
            },
            "probabilities": a.probabilities,
            "gap": self._gap(),
            "where": where_json(self.where, self.before),
            "effects": [self._effect(x) for x in self.explanations],
            "next_test": None if self.next_test is None else self.next_test.as_dict(),
            "expected_nats": self.expected_nats,
            "looks_like": None
            if a.shape is None or a.cause != "unknown"
            else {"shape": a.shape, "physics": next(e.physics for e in catalogue.UNLISTED if e.name == a.shape)},
            "cannot_be_seen": UNSEEN_BY_ALL,
        }
        out["sentences"] = sentences(out)
        if self.terms is not None and self.beyond is not None:
            out |= self._beyond(self.terms, self.beyond)
            out["sentences"] = [
                *out["sentences"][:2],
                beyond_sentence(self.terms.names, out["beyond"]),
                *out["sentences"][2:],
            ]
        return out

    @property
    def lead(self) -> Explanation | None:
        """The named cause (with its second) in the model; None for "none" and "unknown"."""
        return next((x for x in self.explanations if x.names[0] == self.attribution.cause), None)

    def _gap(self) -> dict[str, Any]:
        """Before, and after with the named cause in the model; with none named, after is as before."""
        before, lead = self.before.all, self.lead
        after, (value, low, high) = (before, (0.0, 0.0, 0.0)) if lead is None else (lead.after.all, lead.shrink)
        if self.terms is not None:
            last = gap_size(
                residual_of(self.data, self.terms.steps[-1].fit), self.seed, friction_N=self.before.friction_N
            )
            whole = shrink(self.before, last)
            after, value, low, high = last.all, whole.value, whole.low, whole.high
        ceiling = min(ceiling_N(self.residual), before.rms_N)
        unseen = None if lead is None else lead.unseen
        return {
            "before_rms_N": before.rms_N,
            "after_rms_N": after.rms_N,
            "noise_rms_N": before.noise_N,
            "before_share": before.share,
            "after_share": after.share,
            "shrink": value,
            "shrink_interval": [low, high],
            "ceiling_shrink": 1.0 - ceiling / before.rms_N if before.rms_N > 0.0 else 0.0,
            "held_out": None
            if unseen is None
            else {
                "tests": list(unseen.tests),
                "by": unseen.by,
                "before_rms_N": unseen.before_N,
                "after_rms_N": unseen.after_N,
                "shrink": unseen.shrink,
                "shrink_interval": [unseen.low, unseen.high],
            },
            "before_interval_N": [before.low_N, before.high_N],
            "after_interval_N": [after.low_N, after.high_N],
            "before_share_interval": [before.share_low, before.share_high],
            "residual_rms_N": before.residual_N,
            "averaged_loop_rms_N": self.before.loop.rms_N,
            "along_record_rms_N": self.before.along.rms_N,
            "mains_rms_N": self.before.hum.rms_N,
            "mean_force_rms_N": self.before.mean.rms_N,
        }

    def _beyond(self, terms: Terms, beyond: Diagnosis) -> dict[str, Any]:
        """The paper's terms in the order in which they were taken in, and what remains beyond them."""
        steps, gap = [], self.before
        for step in terms.steps:
            after = gap_size(residual_of(self.data, step.fit), self.seed, friction_N=self.before.friction_N)
            steps.append(
                {
                    "name": step.name,
                    "log_evidence_gain": step.gain,
                    "gap_after_rms_N": after.all.rms_N,
                    "shrink": shrink(gap, after).value,
                    "shrink_from_base": shrink(self.before, after).value,
                }
            )
            gap = after
        left = beyond.as_dict()
        return {
            "terms": steps,
            "beyond": {
                k: left[k] for k in ("verdict", "probabilities", "gap", "where", "effects", "next_test", "sentences")
            },
        }

    def about(self) -> dict[str, dict[str, Any]]:
        """What every effect is, by name: physics, reference, signature, look-alikes, bench."""
        mine = {n: _about(some[0]) for n, some in self.found.effects.items()}
        return mine if self.beyond is None else self.beyond.about() | mine

    @staticmethod
    def _effect(x: Explanation) -> dict[str, Any]:
        numbers = {p: v for n in x.names for p, v in x.parameters[n].items()}
        out = {
            "name": x.names[0],
            "with": list(x.names[1:]),
            "parameters": x.parameters[x.names[0]],
            "log_evidence": x.log_evidence,
            "gap_after_rms_N": x.after.all.rms_N,
            "shrink": x.shrink[0],
            "shrink_interval": list(x.shrink[1:]),
            "shrink_expected": x.shrink_expected,
            "moved": x.moved,
            "all_parameters": numbers,
        }
        if x.unseen is not None:
            out |= {
                "shrink_held_out": x.unseen.shrink,
                "shrink_held_out_interval": [x.unseen.low, x.unseen.high],
                "gap_before_held_out_rms_N": x.unseen.before_N,
                "gap_after_held_out_rms_N": x.unseen.after_N,
                "held_out_by": x.unseen.by,
            }
        return out


def _about(effect: Effect) -> dict[str, Any]:
    return {
        "physics": effect.physics,
        "reference": effect.reference,
        "signature": effect.signature,
        "look_alikes": list(effect.look_alikes),
        "bench": effect.bench,
    }


def diagnose_loops(
    campaign: Campaign,
    loops: Sequence[Loop],
    *,
    seed: int = 0,
    quick: bool = False,
    config: dict | None = None,
    extra: Sequence[type[Effect]] = (),
    simulator: Simulator | None = None,
    progress: Callable[[str], None] = lambda what: None,
) -> Diagnosis:
    """Diagnose averaged loops; tests with role "held-out" are not fitted, only predicted.

    simulator : the base model (default: the Iwan model of the configuration's [model] table).
    """
    config = {k: v for k, v in (config or {}).items() if k in ("model", "parameters")}
    fitted = [x for x in loops if x.role != "held-out"]
    held_out = [x for x in loops if x.role == "held-out"]
    if not fitted:
        raise ValueError('no test is left to fit: every test has role = "held-out"')
    scales: Scales = scales_of(fitted)
    data = gap_data(fitted)
    base = Model(scales.reference, **config.get("model", {})) if simulator is None else simulator
    kinds = catalogue.variants(extra, base, conditions_of([x.extras for x in fitted]))
    rng = np.random.default_rng([seed, 1])
    report = partial(_reported, campaign, seed, quick, config, data, held_out, progress)
    lacking = {e.name: kinds.pop(e.name) for e in missing_terms(base)}
    if not lacking:
        return report(search(data, scales, config, kinds, rng, progress, simulator=base))
    terms = select_terms(data, scales, config, lacking, rng, progress)
    kinds |= {n: k for n, k in lacking.items() if n not in terms.names}
    rest = report(search(data, scales, config, kinds, rng, progress, base=terms.fit))
    return report(terms.search(data, scales, config), terms, rest) if terms.steps else rest


def _reported(
    campaign: Campaign,
    seed: int,
    quick: bool,
    config: dict,
    data: GapData,
    held_out: Sequence[Loop],
    progress: Callable[[str], None],
    found: Search,
    terms: Terms | None = None,
    beyond: Diagnosis | None = None,
) -> Diagnosis:
    """Everything that is said of a finished search."""
    progress("weighing causes")
    if terms is None:
        result = attribute(Table.of(found), {k: moved_shares(f, data) for k, f in found.pairs.items()})
        fits = _leaders(found, result)
    else:
        result, fits = terms.attribution(found), {terms.names: terms.fit}
    residual = residual_of(data, found.base)
    before = gap_size(residual, seed)
    looks = where(residual, seed)
    if not quick:
        fits = {k: sampled_fit(data, f, seed, progress) for k, f in fits.items()}
    progress("tests left out")
    unseen = unseen_gap(found.base, {k[0]: f for k, f in fits.items()}, data, held_out, seed)
    explained = tuple(_explain(k, f, found, before, unseen.get(k[0]), data, seed) for k, f in fits.items())
    if terms is None and explained and _leaves_gap(result, explained[0], before):
        result = doubted(result, "unknown" if before.all.share_low >= JUDGED_SHARE else "none")
    if beyond is not None:  # what comes next is the same with the terms in
        return Diagnosis(
            campaign,
            seed,
            quick,
            config,
            data,
            found,
            result,
            residual,
            before,
            looks,
            explained,
            beyond.not_testable,
            beyond.expected_nats,
            beyond.next_test,
            terms,
            beyond,
        )
    nats = visible_nats(data, found.base, found.effects)
    named = {result.cause, result.second_cause}
    hidden = tuple(n for n, v in nats.items() if v < TESTABLE_NATS and n not in named)
    progress("next test")
    following = _next(data, found, result)
    return Diagnosis(
        campaign, seed, quick, config, data, found, result, residual, before, looks, explained, hidden, nats, following
    )


def _leaves_gap(result: Attribution, lead: Explanation, before: GapSize) -> bool:
    """Does the named cause fail to shrink a gap that is large enough to judge by, both where it was fitted and on tests
    that the fit has not seen? A bias of friction is not judged: it shows in the mean force, which is no part of the
    gap; a hum's phases belong to single records, so no other test can judge it."""
    if result.cause != lead.names[0] or lead.names == ("direction_dependent_friction",):
        return False
    if before.all.share_low < JUDGED_SHARE:  # too small to judge by, but a cause must at least help
        return lead.shrink[0] < LEAST_HELP
    if lead.shrink[0] < LEAST_HELP:  # nor what is worse with the cause than without
        return True
    # tests with role "held-out" check a verdict, so they must not make it
    judges = lead.predicts and lead.unseen is not None and lead.unseen.by != "held-out tests"
    unseen = lead.unseen.shrink if judges and lead.unseen is not None else lead.shrink[0]
    return unseen < LEAST_SHRINK and lead.shrink[0] < LEAST_FITTED_SHRINK


def _leaders(found: Search, result: Attribution) -> dict[tuple[str, ...], Fit]:
    """Fits to report in full: the cause (with its second) first, then others that are not out of the question."""
    out: dict[tuple[str, ...], Fit] = {}
    if result.second_cause is not None:
        key = tuple(sorted((result.cause, result.second_cause)))
        out[result.cause, result.second_cause] = best_fit(found, key)
    elif result.cause not in ("none", "unknown"):
        out[(result.cause,)] = best_fit(found, (result.cause,))
    others = sorted((n for n in result.probabilities if found.singles.get(n)), key=lambda n: -result.probabilities[n])
    for name in others:
        wanted = name in result.cannot_tell_apart or result.probabilities[name] > WORTH_REPORTING or not out
        if wanted and len(out) < 4 and all(k[0] != name for k in out):
            out[(name,)] = best_fit(found, (name,))
    return out


def _explain(
    names: tuple[str, ...], fit: Fit, found: Search, before: GapSize, unseen: Unseen | None, data: GapData, seed: int
) -> Explanation:
    after = gap_size(residual_of(data, fit), seed, friction_N=before.friction_N)
    less = shrink(before, after)
    rng = np.random.default_rng([seed, 2])
    root = np.linalg.cholesky(fit.covariance)
    draws = fit.z + rng.standard_normal((DRAWS, len(fit.z))) @ root.T
    values = fit.problem.prior.values(draws)
    parameters: dict[str, dict[str, dict[str, Any]]] = {}
    for effect in fit.effects:
        told = effect.reported(values)
        law = 1.0 + effect.law_error * rng.standard_normal(DRAWS)
        told = {n: (v * law, unit) for n, (v, unit) in told.items()}
        parameters[effect.name] = {
            n: {
                "mean": float(np.mean(v)),
                "sd": float(np.std(v)),
                "q05": float(np.quantile(v, 0.05)),
                "q95": float(np.quantile(v, 0.95)),
                "unit": unit,
            }
            for n, (v, unit) in told.items()
        }
    small = Fit.log_evidence(fit, calibration().log_small) - Fit.log_evidence(found.base, calibration().log_small)
    return Explanation(
        names,
        fit,
        parameters,
        after,
        (less.value, less.low, less.high),
        unseen,
        _moved(found.base, fit, rng),
        float(small),
    )


def _moved(base: Fit, fit: Fit, rng: np.random.Generator) -> dict[str, dict[str, Any]]:
    """How the base model's own numbers change once the effect is in, and by how many of their standard deviations."""
    out = {}
    b, a = (
        f.problem.prior.values(f.z + rng.standard_normal((400, len(f.z))) @ np.linalg.cholesky(f.covariance).T)
        for f in (base, fit)
    )
    for p in base.problem.prior.free:
        sd = float(np.hypot(b[p.name].std(), a[p.name].std()))
        out[p.name] = {
            "before": float(np.median(b[p.name])),
            "after": float(np.median(a[p.name])),
            "sd": sd,
            "unit": p.unit,
        }
    return out


def _next(data: GapData, found: Search, result: Attribution) -> NextTest | None:
    """The test that best separates the leading explanation from the likeliest other one."""
    if result.cause == "none" and result.probability > 0.9:
        return None
    ranked = [n for n in sorted(result.probabilities, key=lambda n: -result.probabilities[n]) if n != "unknown"]
    ranked = [n for n in ranked if n == "none" or found.singles.get(n)]
    first = result.cause if result.cause != "unknown" else ranked[0]
    rivals = [n for n in (*result.cannot_tell_apart, *ranked) if n not in (first, result.second_cause)]
    if not rivals:
        return None
    second = rivals[0]
    fits = [
        found.base if n == "none" else best_fit(found, (n,))
        for n in (first, second)
        if n == "none" or found.singles.get(n)
    ]
    if len(fits) < 2:
        return None
    bench = [found.effects[n][0].bench for n in (first, second) if n in found.effects]
    return next_test(data, fits[0], fits[1], (first, second), bench)


class Progress:
    """A bar over the stages of a diagnosis, quiet when not a terminal."""

    def __init__(self, name: str, shown: bool = True) -> None:
        self.bar = tqdm(desc=plain(name), disable=None if shown else True, unit=" fits", leave=False)

    def __call__(self, what: str) -> None:
        self.bar.set_postfix_str(what)
        self.bar.update()

    def close(self) -> None:
        self.bar.close()


def diagnose_folder(
    campaign: str | Path,
    *,
    seed: int = 0,
    quick: bool = False,
    config: dict | None = None,
    effects_file: str | Path | None = None,
    simulator_file: str | Path | None = None,
    progress: bool = True,
) -> tuple[Diagnosis, dict[str, Any]]:
    """Diagnose a campaign folder; returns the diagnosis and what `fits.json` is to hold."""
    read = read_campaign(campaign)
    extra = load_effects(effects_file) if effects_file else ()
    simulator = load_simulator(simulator_file) if simulator_file else None
    told = Progress(read.name, progress)
    try:
        result = diagnose_loops(
            read,
            read.loops(**LOOPS),
            seed=seed,
            quick=quick,
            config=config,
            extra=extra,
            simulator=simulator,
            progress=told,
        )
    finally:
        told.close()
    fits = {x.names[0]: x.fit for x in result.explanations}
    files = {
        "effects_file": str(Path(effects_file).resolve()) if effects_file else None,
        "simulator_file": str(Path(simulator_file).resolve()) if simulator_file else None,
    }
    return result, stored_fits(result.found.base, fits, result.found.scales, result.config, **files)


def write_json(path: Path, value: Any) -> None:
    """Write JSON whole or not at all; numbers that are not finite become null."""
    write_whole(path, json.dumps(_finite(value), indent=1) + "\n")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, np.bool_):
        return bool(value)
    return value


def diagnose(campaign: str | Path, out: str | Path, seed: int = 0, quick: bool = False) -> dict[str, Any]:
    """Diagnose and write `diagnosis.json` and `fits.json` only: what the withheld protocol asks for."""
    result, fits = diagnose_folder(campaign, seed=seed, quick=quick)
    answer = result.as_dict()
    write_json(Path(out) / "fits.json", fits)
    write_json(Path(out) / "diagnosis.json", answer)
    return answer
