"""The answer of a diagnosis in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from bayes_iwan.campaign.loops.checks import rails
from bayes_iwan.effects.catalogue import UNLISTED
from bayes_iwan.effects.spanning import LOST
from bayes_iwan.gap.fitting.gap_size import Gap
from bayes_iwan.gap.fitting.leave_out import parted
from bayes_iwan.gap.judging.budget import NO_CAUSE, Cause, Kind

if TYPE_CHECKING:
    from bayes_iwan.gap.diagnosis import Diagnosis, EffectParameter

#: probability above which an effect that is not named is listed
WORTH_LISTING = 0.02
#: effects that are listed where one of many contributes
LISTED = 6
#: by so much the share of what changes along the record must be larger than that of the gap to be told beside it
WORTH_TELLING = 0.1

TITLES = {
    "channel_delay": "a delay between the channels",
    "viscous_damping": "viscous damping",
    "mains_hum": "mains line",
    "force_highpass": "force high-pass",
    "force_lowpass": "force low-pass",
    "integration_highpass": "integration high-pass",
    "slip_forces_free": "slip forces of another distribution",
    "stiffness_law_free": "another law of the stiffness",
    "normal_force_free": "another law of the normal force",
    "none": "no effect outside the model",
    "unknown": "something outside the catalogue",
}


def title(name: str) -> str:
    """An effect's name in running text."""
    what, follows, condition = name.partition("_follows_")
    if follows:
        verb = "follow" if what == "slip_forces" else "follows"
        return f"{what.replace('_', ' ')} that {verb} {condition}"
    return TITLES.get(name, name.replace("_", " "))


def not_excluded(d: Diagnosis) -> list[str]:
    """Effects that are not named and not out of the question, the likeliest first."""
    ranked = sorted(d.verdict.probabilities.items(), key=lambda np: -np[1])
    out = {"none", "unknown", "drive", *d.verdict.names, *NO_CAUSE}
    return [name for name, p in ranked if name not in out and p >= WORTH_LISTING]


def sentences(d: Diagnosis) -> list[str]:
    """The answer: how large the gap is, what makes it, what is left, what to do."""
    which, rest = [*_clipped(d), *_which(d), *_rest(d)], [*_unjudged(d), *_sampled(d), *_remedies(d)]
    return [_size(d.budget.before), *which, *rest, _next(d)]


def _sampled(d: Diagnosis) -> list[str]:
    """Where the draws behind the numbers fall short."""
    if d.sampling is None or d.sampling.converged:
        return []
    return [
        "The draws behind the numbers of the named effects have not converged, so take their intervals with care: "
        f"{d.sampling.message.removeprefix('not converged: ')}."
    ]


def _size(gap: Gap) -> str:
    if gap.low_N <= 0.0:
        return (
            f"The gap between measurement and model is zero within its interval: at most {force(gap.high_N)} RMS, "
            f"{_percent(gap.share_high)} of the friction force, beyond the records' own noise of "
            f"{force(gap.noise_N)}."
        )
    return (
        f"The model misses {force(gap.rms_N)} RMS ({force(gap.low_N)} to {force(gap.high_N)}), "
        f"{_percent(gap.share)} of the friction force, beyond the records' own noise of {force(gap.noise_N)}."
    )


def _clipped(d: Diagnosis) -> list[str]:
    """What the records themselves say of a clipped force, whatever the fits say."""
    at = {x.file: found[0].level for x in d.data.loops if (found := rails(x.record.force_N[x.cut.index], x.n_cycles))}
    if not at:
        return []
    which = ", ".join(f"{file} at {force(level)}" for file, level in list(at.items())[:3])
    return [
        f"The recorded force rests on its extreme value in {len(at)} of {len(d.data.loops)} tests "
        f"({which}{' …' if len(at) > 3 else ''}), as a clipped channel does: raise the force range and record again."
    ]


def _which(d: Diagnosis) -> list[str]:
    if d.verdict.kind is Kind.DRIVE:
        return [
            f"Whose gap this is cannot be told: {_cornered(d)}, and sound channels, which filter what turns at once, "
            f"make a gap of up to {_percent(d.verdict.corners_gap)} of the friction force of such a drive. It is laid "
            "on nothing."
        ]
    drive = []
    if d.verdict.cornered and d.verdict.kind is not Kind.NONE:
        theirs = _percent(d.verdict.corners_gap)
        drive = [f"Of it, up to {theirs} of the friction force may be the channels': {_cornered(d)}."]
    return drive + _found(d)


def _cornered(d: Diagnosis) -> str:
    """Which drives turn at once."""
    files = d.verdict.cornered
    which = ", ".join(files[:3]) + (" …" if len(files) > 3 else "")
    return f"the drive of {len(files)} test{'s' if len(files) > 1 else ''} has corners ({which})"


def _found(d: Diagnosis) -> list[str]:
    if d.verdict.causes:
        return [_sentence(c, d) for c in d.verdict.causes] + _one_of(d)
    if d.verdict.one_of:
        return _one_of(d)
    others = not_excluded(d)
    tail = f"; {listed(others)} cannot be excluded" if others else ""
    if d.verdict.kind is Kind.NONE:
        return [
            f"No effect outside the model is needed (probability {d.verdict.probabilities['none']:.2f}): what is left "
            f"is no more than a real specimen's usual difference from the model{tail}."
        ]
    return [
        f"The cause is unknown (probability {d.budget.rest.probability:.2f}): the gap is real, but no effect of the "
        f"catalogue explains a part of it that holds on all tests{tail}.",
    ]


def _suspects(d: Diagnosis) -> list[str]:
    """What alone would remove most of a gap, most of which has no name."""
    if not d.verdict.suspects:
        return []
    some = ", ".join(f"{title(x.name)} ({_percent(x.share)})" for x in d.verdict.suspects)
    return [f"Alone in the model, these would remove most of the gap, but its shape does not speak for them: {some}."]


def _unjudged(d: Diagnosis) -> list[str]:
    """Where no test can be left out, what is said rests on the fit alone."""
    if d.verdict.kind in (Kind.NONE, Kind.DRIVE) or parted(d.data):
        return []
    return [
        "Nothing of this could be judged on tests left out of the fit, for all are of one frequency and one amplitude: "
        "record others."
    ]


def _one_of(d: Diagnosis) -> list[str]:
    """Places that something fills, these tests cannot tell what: the likeliest, and how many more."""
    out = []
    for x in d.verdict.one_of:
        more = len(x.names) - LISTED
        some = listed(x.names, "or") if more < 2 else f"{', '.join(map(title, x.names[:LISTED]))} or {more} others"
        out.append(
            f"One of {some} removes {_percent(x.share)} of the gap (together of probability {x.probability:.2f}); "
            "these tests cannot tell which."
        )
    return out


def _sentence(c: Cause, d: Diagnosis) -> str:
    """One cause: its size, its share of the gap, fitted and on tests left out, and what it cannot be told from."""
    name = title(c.name)
    verb = "remove" if name.startswith("slip forces") else "removes"
    text = f"{_capital(name)}{_strength(d.parameters[c.name])} (probability {c.probability:.2f}) {verb} "
    text += f"{_percent(c.share.value)} of the gap ({_percent(c.share.low)} to {_percent(c.share.high)})"
    if c.held_out is not None:
        text += f", {_percent(c.held_out.value)} on tests left out of the fit"
    if c.along is not None and c.along > c.share.value + WORTH_TELLING:
        text += f", and {_percent(c.along)} of what changes along the record"
    if c.cannot_tell_apart:
        text += f"; these tests cannot tell it from {listed(c.cannot_tell_apart)}"
    return text + "."


def _strength(parameters: Mapping[str, EffectParameter]) -> str:
    """The first parameter with its standard deviation."""
    if not parameters:
        return ""
    name, p = next(iter(parameters.items()))
    unit = "" if p.unit in ("-", "") else f" {p.unit}"
    what, mean = name.split("[")[0].replace("_", " "), p.mean
    if name == LOST and mean < 0.0:
        what, mean = what.replace("lost", "regained"), -mean
    number = f"{mean:.3g} ± {np.format_float_positional(float(f'{p.sd:.1g}'), trim='-')}"
    return f" of {number}{unit}" if unit else f" ({what} {number})"


def _rest(d: Diagnosis) -> list[str]:
    rest, kind = d.budget.rest, d.verdict.kind
    if kind is Kind.EXPLAINED:
        return [f"What is left, {_percent(rest.share.value)} of the gap, is no more than a law slightly off leaves."]
    if kind in (Kind.NONE, Kind.DRIVE):
        return []
    out = []
    if kind is Kind.PARTLY:
        out.append(
            f"The cause of the rest, {_percent(rest.share.value)} of the gap, is unknown "
            f"(probability {rest.probability:.2f} that it has one)."
        )
    out += _suspects(d)
    physics = physics_of_rest(rest.looks_like)
    if physics:
        out.append(f"It looks most like {physics}.")
    if rest.subharmonic > 20.0:
        out.append("The records hold a line at half the test frequency: every second cycle differs.")
    return out


def physics_of_rest(looks_like: str | None) -> str | None:
    """What a form without a cause stands for, in words."""
    return next((e.physics for e in UNLISTED if e.name == looks_like), None)


def remedy(d: Diagnosis, name: str) -> str:
    """What to do about a named effect, as its author says it."""
    return str(getattr(d.search.effects[name][0], "remedy", ""))


def _remedies(d: Diagnosis) -> list[str]:
    return [f"{_capital(title(n))}: {said.rstrip('.')}." for n in d.verdict.names if (said := remedy(d, n))]


def _next(d: Diagnosis) -> str:
    if d.verdict.kind is Kind.DRIVE:
        return "Run these tests again with sines; then a diagnosis can tell."
    following = d.next_test
    if following is None:
        return "No further loop test is needed to settle which of the catalogue's effects contribute."
    pair = listed(following.separates)
    if following.bench:
        return f"No loop test would separate {pair} well; at the bench: {following.bench}."
    return (
        f"To separate {pair}, run {following.frequency_hz:g} Hz at {following.amplitude_mm:g} mm for "
        f"{following.cycles} cycles (expected odds {_odds(following.expected_log_odds)})."
    )


def _odds(log_odds: float) -> str:
    return "over 1000 : 1" if log_odds > 6.9 else f"{2.718281828**log_odds:.0f} : 1"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if abs(share) < 0.095 else f"{100 * share:.0f} %"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def listed(names: Sequence[str], last: str = "and") -> str:
    """Names of effects in running text."""
    words = [title(n) for n in names]
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + f" {last} " + words[-1]


def force(newton: float) -> str:
    """A force to three digits in kN, N or mN."""
    for scale, unit in ((1e3, "kN"), (1.0, "N"), (1e-3, "mN")):
        if newton >= scale:
            return f"{newton / scale:.3g} {unit}"
    return f"{newton / 1e-3:.2g} mN"
