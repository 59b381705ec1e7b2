"""The answer of a diagnosis in one screen of plain sentences, and what colour its box has."""

from collections.abc import Sequence

from bayes_iwan.campaign.timing.groups import groups_of
from bayes_iwan.diagnosis.answer.growth_laws import LEAST_RATIO
from bayes_iwan.diagnosis.answer.imitation import Imitation, said_in_text
from bayes_iwan.diagnosis.answer.next_test import NextTest
from bayes_iwan.diagnosis.answer.result import Diagnosis
from bayes_iwan.diagnosis.answer.wording import (
    MOST_NAMES,
    capital,
    few,
    force,
    interval,
    listed,
    odds,
    percent,
    physics_of_pattern,
    plain,
    probability,
    strength,
    title,
)
from bayes_iwan.diagnosis.assessment.budget import NO_CAUSE, Cause, Kind
from bayes_iwan.diagnosis.assessment.verdict import cycles_differ, refused
from bayes_iwan.diagnosis.constants import LINE_STANDS, PROBABLE
from bayes_iwan.diagnosis.fits.gap_size import Gap
from bayes_iwan.diagnosis.fits.held_out_tests import parted

#: probability above which an effect that is not named is listed
LISTED = 0.02
#: by so much the share of what changes along the record must be larger than that of the gap to be said beside it
ALONG_SAID = 0.1
#: share of the friction force that the base misses from which it is said not to describe the specimen at all
NO_MODEL = 0.8
#: effects that a record itself shows, whatever its frequency
NO_TIME_CONSTANT = frozenset({"force_drift", "mains_interference"})
#: base parameters at the edge that the text holds; the page holds all
EDGES_SAID = 3


def not_excluded(d: Diagnosis) -> list[str]:
    """Effects that are not named and not out of the question, the likeliest first."""
    ranked = sorted(d.verdict.probabilities.items(), key=lambda np: -np[1])
    out = {"none", "unknown", "drive", *d.verdict.names, *NO_CAUSE}
    return [name for name, p in ranked if name not in out and p >= LISTED]


def sentences(d: Diagnosis) -> list[str]:
    """The answer: size of the gap, its causes with number, share and remedy, ties, what is unexplained, what these
    tests cannot tell, and the next test."""
    out = [_size(d), *_clipped(d), *_kind(d), *(_cause(c, d) for c in d.verdict.causes), *_one_of(d)]
    out += [*_suspects(d), *_imitations(d), _unexplained(d), *_resembles(d)]
    out += [*_edges(d), *_no_clock(d), *_not_tested(d), *_not_converged(d), next_sentence(d)]
    return out


def colour(d: Diagnosis) -> str:
    """Of the answer's box: "good" only where nothing below it warns."""
    if d.verdict.kind is not Kind.NONE or d.clipped:
        return "warning"
    contradicted, tied = d.verdict.probabilities["none"] < PROBABLE, any(x.said for x in d.imitations)
    hidden = d.edges or not d.campaign.clock
    return "note" if contradicted or tied or hidden else "good"


def _size(d: Diagnosis) -> str:
    gap = d.budget.before
    if gap.low_N <= 0.0:
        return f"The model misses nothing beyond noise{_at_most(gap)} (noise {force(gap.noise_N)})."
    ends = interval((gap.low_N, gap.high_N), force)
    ends = "" if ends == interval([gap.rms_N] * 2, force) else f" ({ends})"
    text = f"The model misses {force(gap.rms_N)} RMS{ends}, {percent(gap.share)} of the friction force "
    text += f"(noise {force(gap.noise_N)})"
    if d.before.along.rms_N > 0.5 * gap.rms_N:
        text += f"; of that {force(d.before.along.rms_N)} change along the records"
    if gap.share > NO_MODEL:
        text += ". That is nearly all of it: the base model does not describe this specimen"
    return text + "."


def _at_most(gap: Gap) -> str:
    """The upper end of what noise hides, where that is anything."""
    share = percent(gap.share_high)
    return "" if share == percent(0.0) else f": at most {force(gap.high_N)} RMS, {share} of the friction force"


def _clipped(d: Diagnosis) -> list[str]:
    """What the records themselves say of a clipped force, whatever the fits say."""
    limits = [x for x in d.clipped if x.channel == "force"]
    if not limits:
        return []
    files = list(dict.fromkeys(x.file for x in limits))
    level = {x.file: x.level for x in reversed(limits)}
    which = ", ".join(f"{f} at {force(level[f])}" for f in files[:MOST_NAMES])
    return [
        f"The force may be clipped in {len(files)} of {len(d.data.loops)} tests ({which}"
        f"{' …' if len(files) > MOST_NAMES else ''}). If so, slip forces come out too small. Raise the force range and "
        "record again."
    ]


def _kind(d: Diagnosis) -> list[str]:
    """The verdict in a sentence, where no cause is named; and what of a gap may be the drive's."""
    v = d.verdict
    if v.kind is Kind.DRIVE:
        return [
            f"The cause cannot be found: {_cornered(d)}. Sound channels, which filter what turns at once, leave a gap "
            f"of up to {percent(v.corners_gap)} of the friction force with such a drive."
        ]
    out = []
    if v.cornered and v.kind is not Kind.NONE:
        out.append(f"Up to {percent(v.corners_gap)} of the friction force may be the channels': {_cornered(d)}.")
    if v.causes:
        return out
    none, others = v.probabilities["none"], not_excluded(d)
    if v.kind is Kind.NONE and none >= PROBABLE:
        tail = f" {capital(few(others, 'and'))} cannot be excluded." if others else ""
        return [*out, f"No effect outside the model is needed (probability {probability(none)}).{tail}"]
    if v.kind is Kind.NONE:
        named = [(title(n), v.probabilities[n]) for n in others[:MOST_NAMES]]
        named += [("a cause without a name", v.probabilities["unknown"])]
        some = ", ".join(f"{name} ({probability(p)})" for name, p in named if p >= LISTED)
        return [
            *out,
            f"No effect is named, though something probably contributes (probability {probability(1.0 - none)}): "
            f"{some}. These tests do not tell what.",
        ]
    if v.one_of:
        return out
    why = "no known effect explains it in all tests" if d.data.tests > 1 else "one test does not show its cause"
    p = probability(d.budget.unexplained.probability)
    if _differ(d):
        return [*out, f"Cause unknown (probability {p}). No known effect makes cycles differ as these do."]
    return [*out, f"Cause unknown (probability {p}). The gap is real, but {why}."]


def _cornered(d: Diagnosis) -> str:
    """Which tests turn at once, by their drive or by what their sensor makes of it."""
    files = d.verdict.cornered
    which = ", ".join(files[:MOST_NAMES]) + (" …" if len(files) > MOST_NAMES else "")
    return f"the displacement of {len(files)} test{'s' if len(files) > 1 else ''} has corners ({which})"


def _cause(c: Cause, d: Diagnosis) -> str:
    """One cause: its number, its share of the gap, fitted and on held-out tests, its ties, its remedy."""
    numbers = {n: (p.mean, p.sd, p.unit) for n, p in d.parameters[c.name].items()}
    side = ""
    if c.name == "end_stop" and numbers and next(iter(numbers.values()))[0] < 0.0:
        name, (mean, sd, unit) = next(iter(numbers.items()))
        numbers, side = {name: (-mean, sd, unit)}, " on the side of negative displacement"
    verb = "remove" if title(c.name).startswith("slip forces") else "removes"
    text = f"{capital(title(c.name))}{strength(numbers)}{side} (probability {probability(c.probability)}) {verb} "
    text += f"{percent(c.share.value)} of the gap ({percent(c.share.low)} to {percent(c.share.high)})"
    if c.held_out is not None:
        on, value = "on held-out tests", c.held_out.value
        text += f", {percent(value)} {on}" if value > 0.0 else f", but nothing {on}, where its numbers do not hold"
    if c.along is not None and c.along > c.share.value + ALONG_SAID:
        text += f", and {percent(c.along)} of what changes along the records"
    text += "."
    if c.share.low <= 0.0 and c.gaps.last <= c.vague.data:  # two that only help together remove nothing alone
        text += " Its share may be nothing."
    if len(d.verdict.causes) > 1:
        on = "" if c.held_out is None else " on held-out tests"
        text += f" Gap left{on}: {percent(c.gaps.with_all)} with all named effects, {percent(c.gaps.without)} without "
        text += f"this one, {percent(c.gaps.alone)} with this one alone."
    if c.tied_with:
        text += f" These tests cannot tell it from {few(c.tied_with)}."
    why = _confounded(d)
    if why and d.search.effects[c.name][0].needs_clock and c.name not in NO_TIME_CONSTANT:
        text += f" {why}: a dependence on time could be one on amplitude."
    said = remedy(d, c.name)
    if c.name == "force_clipping" and not d.clipped:  # no amplifier: the remedy of one would be wrong
        said = "No record shows the one level of an amplifier: a specimen that yields or slides there does the same"
    return f"{text} {said.rstrip('.')}." if said else text


def remedy(d: Diagnosis, name: str) -> str:
    """What to do about a named effect, as its author says it."""
    return str(getattr(d.search.effects[name][0], "remedy", ""))


def _one_of(d: Diagnosis) -> list[str]:
    """Places that something fills, these tests cannot tell what: the likeliest, and how many more."""
    out = []
    for x in d.verdict.one_of:
        what = f"{percent(max(x.share, 0.0))} of the gap"
        if x.along is not None and x.along > x.share + ALONG_SAID:
            what += f" and {percent(x.along)} of what changes along the records"
        out.append(
            f"One of {few(x.names)} probably contributes (probability {probability(x.probability)} together); the "
            f"best of them would remove {what}. These tests do not tell which, so none is named."
        )
    return out


def _suspects(d: Diagnosis) -> list[str]:
    """What alone would remove most of a gap, most of which has no name."""
    some = d.verdict.suspects
    if not some:
        return []
    why = {f.name: f"; {refused(f)}" for f in d.found.figures if refused(f)}
    which = ", ".join(f"{title(x.name)} (by {percent(x.share)}{why.get(x.name, '')})" for x in some[:MOST_NAMES])
    more = f" and {len(some) - MOST_NAMES} more" if len(some) > MOST_NAMES else ""
    if parted(d.data):
        return [f"Each of these would reduce the gap, but its fit or its numbers speak against it: {which}{more}."]
    return [f"Each of these would reduce the gap, but tests that are all alike show no cause: {which}{more}."]


def _imitations(d: Diagnosis) -> list[str]:
    """Dependences that a freedom of the base and an effect explain alike."""
    return [_imitation(x, d) for x in said_in_text(d.imitations)]


def _imitation(x: Imitation, d: Diagnosis) -> str:
    share = {e.name: e.share for e in x.explanations}
    least, most = min(share[n] for n in x.tied), max(share[n] for n in x.tied)
    left = percent(least) if percent(least) == percent(most) else f"{percent(least)} to {percent(most)}"
    named = [n for n in x.tied if n in d.verdict.names]
    # the list is cut, and the base's own freedom is the point
    own_second = sorted(x.tied[1:], key=lambda n: n != x.name)
    own = title(x.name)
    text = f"{capital(x.what)}: {few([x.tied[0], *own_second])}.".replace(own, f"{own} (the model's own)")
    if max(x.explanations, key=lambda e: e.nats).name in named:
        text += f" The evidence is for {listed(named)}."
    elif named:
        why = "is named, since it helps" if len(named) == 1 else "are named, since they help"
        text += f" {capital(listed(named))} {why} beside the model's own."
    else:
        text += " These tests do not tell which."
    text += f" With one of them alone the model would miss {left} of the friction force"
    with_own, none = percent(share[x.name]), percent(x.without)
    text += f", with {own} instead {with_own}" if x.name not in x.tied and with_own != none else ""
    text += f", with none {none}."
    why = _confounded(d)
    if x.what == "speed dependence" and why:
        text += f" {why}, so a dependence on amplitude would look alike."
    return text


def _confounded(d: Diagnosis) -> str:
    """Why a dependence on frequency could be one on amplitude; nothing where it could not, or all tests are alike,
    which is said already."""
    hz = [loop.frequency_hz for loop in d.data.loops]

    def alike(tests: Sequence[int]) -> bool:
        return max(hz[i] for i in tests) < LEAST_RATIO * min(hz[i] for i in tests)

    if not parted(d.data):
        return ""
    if alike(range(len(hz))):
        return "The tests' frequencies hardly differ"
    each = groups_of([loop.amplitude_mm for loop in d.data.loops])
    return "Each amplitude was run at one frequency" if all(alike(tests) for tests in each) else ""


def _unexplained(d: Diagnosis) -> str:
    """What no named effect removes: always said."""
    unexplained, after = d.budget.unexplained, d.budget.after
    kind = d.verdict.kind
    share = percent(1.0 if not d.verdict.causes else unexplained.share.value)
    if after.low_N <= 0.0 and (_differ(d) or not d.verdict.unknown_cause):
        return f"Unexplained: nothing beyond noise{_at_most(after)}."
    size = f"{share} of the gap, {force(after.rms_N)}, {percent(after.share)} of the friction force"
    if d.verdict.one_of and not d.verdict.causes:
        size += ", since nothing is named"
    if kind is Kind.EXPLAINED:
        return f"Unexplained: {size}. A law that is slightly off leaves as much."
    if kind is Kind.NONE:
        return f"Unexplained: {size}. A sound specimen differs from the model by as much as is beyond noise."
    if kind is Kind.DRIVE:
        return f"Unexplained: {size}. It may be the channels' or the specimen's."
    what = "a cause: one of these or another" if d.verdict.one_of else "a cause of its own"
    return f"Unexplained: {size} (probability {probability(unexplained.probability)} that it has {what})."


def _resembles(d: Diagnosis) -> list[str]:
    """What the unexplained part resembles."""
    out, unexplained = [], d.budget.unexplained
    physics = physics_of_pattern(unexplained.resembles) if d.verdict.kind in (Kind.PARTLY, Kind.UNKNOWN) else None
    if physics:
        out.append(f"{percent(unexplained.resembling)} of the gap resembles this: {physics.rstrip('.')}.")
    if not _differ(d):
        return out
    if d.data.subharmonic.max() > LINE_STANDS:
        return [
            *out,
            "Every second cycle differs: the records hold a line at half the test frequency, which averaged "
            "loops hide.",
        ]
    return [
        *out,
        f"Cycles differ by {percent(d.data.not_repeating)} of the friction force, trends and white noise not "
        "counted, which averaged loops hide. Debris, stick-slip, a sharp run-in and bursts of noise do that.",
    ]


def _differ(d: Diagnosis) -> bool:
    """Is it said that cycles differ as no known effect makes them?"""
    return d.verdict.unknown_cause and cycles_differ(d.data, d.verdict.names)


def _edges(d: Diagnosis) -> list[str]:
    """Base parameters far from what their priors hold plausible."""
    if not d.edges:
        return []
    unit = {x.name: "" if x.unit in ("-", "") else f" {x.unit}" for x in d.edges}
    meaning = {p.name: p.description for p in d.search.base.problem.prior.free}
    some = ", ".join(
        f"{meaning[x.name]} ({x.name} = {plain(x.value)}{unit[x.name]}, {x.deviations:+.1f} prior sd)"
        for x in d.edges[:EDGES_SAID]
    )
    more = f" and {len(d.edges) - EDGES_SAID} more" if len(d.edges) > EDGES_SAID else ""
    return [
        f"Far from plausible in the base model: {some}{more}. Widen the prior, or look for an effect that it stands "
        "for."
    ]


def _no_clock(d: Diagnosis) -> list[str]:
    if d.campaign.clock:
        return []
    return [
        "The records have no clock, so nothing that needs one is testable: speed, frequency, delays, filters, mass, "
        "drift and mains interference."
    ]


def _not_tested(d: Diagnosis) -> list[str]:
    """Where no test can be held out, what is said is of the fit alone."""
    if d.verdict.kind in (Kind.NONE, Kind.DRIVE) or parted(d.data):
        return []
    alike = "one frequency and one amplitude" if d.campaign.clock else "one amplitude"
    all_of = "There is one test" if len(d.data.loops) == 1 else f"All tests have {alike}"
    return [f"{all_of}, so nothing of this was checked on held-out tests."]


def _not_converged(d: Diagnosis) -> list[str]:
    """Where the draws behind the numbers fall short."""
    if d.sampling is None or d.sampling.converged:
        return []
    return [
        "The draws behind the numbers of the named effects have not converged, so take their intervals with care: "
        f"{d.sampling.message.removeprefix('not converged: ')}."
    ]


def next_sentence(d: Diagnosis) -> str:
    """What to do next."""
    if d.verdict.kind is Kind.DRIVE:
        return "Next: run these tests again with sines; if they were sines, check the displacement sensor."
    following = d.next_test
    if following is None and d.verdict.kind is not Kind.NONE and not parted(d.data):
        return "Next: record other amplitudes" + (" and frequencies." if d.campaign.clock else ".")
    if following is None and d.verdict.kind is Kind.NONE and d.verdict.probabilities["none"] >= PROBABLE:
        return "Next: no further test is needed."
    if following is None and _differ(d):
        return "Next: look at the cycles one by one (bayes-iwan inspect)."
    if following is None and not d.verdict.causes and not d.verdict.one_of:
        return "Next: no known effect is left for a test to separate; where the gap sits leads to its cause."
    if following is None:
        return "Next: no further test would separate these effects better."
    verb, what, whose = in_question(following)
    if following.bench:
        return f"Next: {following.bench}. No one test that this rig can run would {verb} {what} well."
    by = odds(following.expected_log_odds)
    return f"Next: run {planned(following)}. It {verb}s {what} (it would change {whose} odds by {by})."


def in_question(test: NextTest) -> tuple[str, str, str]:
    """What a test is for: its verb, what it separates or tells, and whose odds these are."""
    some = [n for n in test.separates if n != "none"]
    if len(some) == 1:
        return "tell", f"whether there is {title(some[0])}", "its"
    return "separate", listed(some), "their"


def planned(test: NextTest) -> str:
    """The test in words; without a clock it has no frequency."""
    at = "" if test.frequency_hz is None else f"{plain(test.frequency_hz)} Hz at "
    return f"{at}{plain(test.amplitude_mm)} mm for {test.cycles} cycles"
