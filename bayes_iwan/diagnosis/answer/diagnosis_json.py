"""A diagnosis as `diagnosis.json` holds it (schema 3), and as sentences: text begins here, types end."""

from dataclasses import asdict
from pathlib import Path

from bayes_iwan.diagnosis.answer.gap_findings import where_json
from bayes_iwan.diagnosis.answer.result import Diagnosis
from bayes_iwan.diagnosis.answer.saved_fits import write_fits
from bayes_iwan.diagnosis.answer.sentences import colour, not_excluded, remedy, sentences
from bayes_iwan.diagnosis.answer.wording import physics_of_pattern
from bayes_iwan.diagnosis.assessment.budget import Cause
from bayes_iwan.diagnosis.fits.gap_size import Share, ceiling_N
from bayes_iwan.files import finite, write_json
from bayes_iwan.models.user_file import file_of

SCHEMA = 3
#: where no test can be held out, the three gaps of an effect are of these
FITTED = "fitted tests"
#: what no loop test can see, whatever the cause
INVISIBLE = (
    "A gain error of the displacement channel is absorbed whole by the stiffnesses, one of the force "
    "channel by stiffnesses and slip forces together: no loop test can see either. Check both against a "
    "known spring. A compliance in series hides in other slip forces; only a twentieth of it shows."
)


def to_dict(d: Diagnosis) -> dict[str, object]:
    """The schema of `diagnosis.json`, its texts in the campaign's own units (keys name the working units); numbers that
    are not finite become null when it is written.

    Of each cause `gaps` has the gap with all named effects, without this one and with this one alone, over the base
    model's on the same tests (`on`), and `share_vague` what the interval of its share is made of
    (:class:`bayes_iwan.diagnosis.assessment.budget.Vague`).
    """
    v, b = d.verdict, d.budget
    left = b.unexplained.share if v.causes else Share(1.0, 1.0, 1.0)
    out: dict[str, object] = {
        "schema": SCHEMA,
        "seed": d.seed,
        "quick": d.quick,
        "sampling": None if d.sampling is None else asdict(d.sampling),
        "campaign": d.campaign.name,
        "base": d.settings.as_dict()["model"],
        "verdict": {
            "kind": v.kind.value,
            "causes": [_cause(c) for c in v.causes],
            "one_of": [asdict(x) for x in v.one_of],
            "suspects": [asdict(x) for x in v.suspects],
            "unknown_cause": v.unknown_cause,
            "cornered_drives": list(v.cornered),
            "cause": v.cause,
            "second_cause": v.names[1] if len(v.names) > 1 else None,
            "probability": v.probabilities[v.cause],
            "tied_with": list(v.causes[0].tied_with) if v.causes else [],
            "not_testable": list(d.not_testable),
            "needs_clock": list(d.needs_clock),
            "colour": colour(d),
        },
        "probabilities": {"unknown_cause" if n == "unknown" else n: p for n, p in v.probabilities.items()},
        "unexplained": {
            "probability": b.unexplained.probability,
            "share": b.unexplained.share.value,
            "interval": [b.unexplained.share.low, b.unexplained.share.high],
            "share_of_friction": b.unexplained.of_friction,
            "where": list(b.unexplained.where),
            "resembles": b.unexplained.resembles,
            "resembling_share": b.unexplained.resembling,
            "physics": physics_of_pattern(b.unexplained.resembles),
            "line_at_half_frequency": float(d.data.subharmonic.max()),
            "not_repeating_share_of_friction": d.data.not_repeating,
        },
        "gap": {
            "before_rms_N": b.before.rms_N,
            "before_interval_N": [b.before.low_N, b.before.high_N],
            "before_share": b.before.share,
            "before_share_interval": [b.before.share_low, b.before.share_high],
            "after_rms_N": b.after.rms_N,
            "after_interval_N": [b.after.low_N, b.after.high_N],
            "after_share": b.after.share,
            "shrink": 1.0 - left.value,
            "shrink_interval": [1.0 - left.high, 1.0 - left.low],
            "ceiling_shrink": ceiling_shrink(d),
            "noise_rms_N": b.before.noise_N,
            "residual_rms_N": b.before.residual_N,
            "averaged_loop_rms_N": d.before.loop.rms_N,
            "along_record_rms_N": d.before.along.rms_N,
            "mains_rms_N": d.before.mains.rms_N,
            "mean_force_rms_N": d.before.mean.rms_N,
        },
        "where": where_json(d.where, d.before),
        "effects": [_effect(d, c) for c in v.causes],
        "considered": _considered(d),
        "failed": dict(d.search.failed),
        "moved": {n: asdict(m) for n, m in d.moved.items()},
        "imitations": [asdict(x) for x in d.imitations],
        "far_from_plausible": [asdict(x) for x in d.edges],
        "clipped": [asdict(x) for x in d.clipped],
        "clock": d.campaign.clock,
        "next_test": None if d.next_test is None else asdict(d.next_test),
        "expected_nats": d.expected_nats,
        "cannot_be_seen": INVISIBLE,
        "sentences": sentences(d),
    }
    return {**d.campaign.units.everywhere(out), "campaign": d.campaign.name}


def _interval(share: Share | None) -> list[float] | None:
    return None if share is None else [share.low, share.high]


def _cause(c: Cause) -> dict[str, object]:
    return {
        "name": c.name,
        "law": c.law,
        "probability": c.probability,
        "share": c.share.value,
        "share_interval": _interval(c.share),
        "share_vague": asdict(c.vague),
        "share_held_out": None if c.held_out is None else c.held_out.value,
        "share_held_out_interval": _interval(c.held_out),
        "held_out_by": c.held_out_by or None,
        "gaps": {
            "on": c.held_out_by or FITTED,
            "with_all": c.gaps.with_all,
            "without": c.gaps.without,
            "alone": c.gaps.alone,
        },
        "share_along_record": c.along,
        "tied_with": list(c.tied_with),
    }


def _effect(d: Diagnosis, c: Cause) -> dict[str, object]:
    f = c.figures
    return {
        "name": c.name,
        "parameters": {n: asdict(x) for n, x in d.parameters[c.name].items()},
        "log_evidence": f.gain,
        "alternatives": f.alternatives,
        "moved_share": f.moved,
        "remedy": remedy(d, c.name),
    }


def _considered(d: Diagnosis) -> list[dict[str, object]]:
    """Effects that are not named and not out of the question, the likeliest first; and why they are not named."""
    places = {f.name: f for f in d.found.figures}
    out = []
    for name in not_excluded(d):
        f = places.get(name)
        single = d.search.fits.get(frozenset({name}))
        out.append(
            {
                "name": name,
                "probability": d.verdict.probabilities[name],
                "log_evidence_alone": None if single is None else single.log_evidence - d.search.base.log_evidence,
                "shrink": None if f is None else f.fitted,
                "shrink_held_out": None if f is None else f.held_out,
            }
        )
    return out


def ceiling_shrink(d: Diagnosis) -> float:
    """Share of the gap that a smooth discrepancy of any shape would remove, or that all named effects or one of those
    not separated do: no effect can be expected to remove more."""
    before_N = d.budget.before.rms_N
    if before_N <= 0.0:
        return 0.0
    left_N = min(ceiling_N(d.residual), d.budget.after.rms_N)
    said = [x.share for x in d.verdict.one_of] + [x.share for x in d.verdict.suspects]
    return max(0.0, 1.0 - left_N / before_N, *said)


def write_answer(d: Diagnosis, out: Path) -> dict[str, object]:
    """Write `diagnosis.json` and `fits.json`; returns what the first holds. What was fitted with effects or a simulator
    that were no file's cannot be read back from `fits.json`."""
    answer = finite(to_dict(d))
    named = {k: f for k, f in d.found.models.nearest.items() if k <= set(d.verdict.names)}
    kinds = [type(e) for some in d.search.effects.values() for e in some]
    effects = next((str(f) for f in map(file_of, kinds) if f is not None), None)
    model = file_of(type(d.search.base.problem.model))
    write_fits(out / "fits.json", named, d.search.scales, d.settings, effects, None if model is None else str(model))
    write_json(out / "diagnosis.json", answer)
    return answer
