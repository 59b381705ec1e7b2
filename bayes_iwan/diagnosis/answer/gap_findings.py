"""Size and place of the gap as plain sentences and as JSON."""

import numpy as np

from bayes_iwan.diagnosis.answer.growth_laws import GrowthLaw
from bayes_iwan.diagnosis.answer.localisation import Statistic, Where
from bayes_iwan.diagnosis.answer.wording import force, joined, percent
from bayes_iwan.diagnosis.fits.gap_size import GapSize

#: a part of the loop gets a sentence when its share of the gap is this many times its share of the time
CONCENTRATED = 1.25
#: and a law when it explains this share of what the first explains
LEAST_GAIN = 0.01
#: a power whose interval is wider than this is not reported; nor then is the sign of what is missing
OPEN = 2.0
_ORDINALS = {1: "first harmonic", 2: "second harmonic", 3: "third harmonic"}


def where_sentences(where: Where) -> list[str]:
    """One sentence for each finding, in plain words; a single one where nothing stands out."""
    parts = (_tests, _grows, _laws, _harmonics, _regions, _record, _others)
    out = [sentence for part in parts for sentence in part(where)]
    if not out:
        return [
            f"Nothing stands out: none of {where.count} statistics is larger than noise, the parameters' uncertainty "
            "and the usual small discrepancy of a sound specimen."
        ]
    return [*out, f"Each finding is significant at 5 %, corrected for {where.count} statistics."]


def where_json(where: Where, size: GapSize) -> dict[str, object]:
    """The "where" of a diagnosis as plain numbers."""
    tests = [
        {
            "file": name,
            "frequency_hz": float(where.frequency_hz[t]) if where.clock else None,
            "amplitude_mm": float(where.amplitude_mm[t]),
            "gap_rms_N": g.rms_N,
            "interval_N": [g.low_N, g.high_N],
            "share": g.share,
            "significant": where.stands_out[t],
            "along_record_N": along.gap_N,
            "along_record_significant": along.significant,
        }
        for t, (name, g, along) in enumerate(zip(where.files, size.tests, where.of("trend")))
    ]
    harmonics = [
        {
            "order": h + 1,
            "in_phase_N": p.gap_N,
            "in_phase_interval_N": [p.low_N, p.high_N],
            "in_phase_significant": p.significant,
            "quadrature_N": q.gap_N,
            "quadrature_interval_N": [q.low_N, q.high_N],
            "quadrature_significant": q.significant,
            "significant": p.significant or q.significant,
        }
        for h, (p, q) in enumerate(zip(where.of("in phase"), where.of("quadrature")))
    ]
    return {
        "statistics": where.count,
        "tests": tests,
        "regions": [_statistic(x, "region") for x in where.of("region")],
        "harmonics": harmonics,
        "by_frequency": [_statistic(x, "frequency") for x in where.of("frequency")] if where.clock else [],
        "by_amplitude": [_statistic(x, "amplitude") for x in where.of("amplitude")],
        "parity": [_statistic(x, "parity") for x in where.of("parity")],
        "mean": _statistic(where.of("mean")[0], "what"),
        "along_record": [_statistic(x, "what") for x in where.of("record")],
        "mains": [_statistic(x, "line") for x in where.of("mains")] if where.clock else [],
        "laws": [
            {
                "order": x.order,
                "part": x.part,
                "force_N": x.force_N,
                "sd_N": x.sd_N,
                "frequency_power": _power(x.frequency_power),
                "amplitude_power": _power(x.amplitude_power),
                "p_value": x.p_value,
            }
            for x in where.laws
        ],
        "sentences": where_sentences(where),
    }


def _statistic(x: Statistic, key: str) -> dict[str, object]:
    return {
        key: x.name,
        "gap_rms_N": x.gap_N,
        "interval_N": [x.low_N, x.high_N],
        "share_of_gap": x.share,
        "share_of_time": x.time,
        "p_value": x.p_value,
        "significant": x.significant,
    }


def _power(power: tuple[float, float, float] | None) -> dict[str, float] | None:
    return None if power is None else dict(zip(("value", "low", "high"), power))


def _tests(w: Where) -> list[str]:
    found = [x for x in w.of("test") if x.significant]
    if not found:
        return []
    t = int(np.argmax([x.gap_N for x in w.of("test")]))
    worst = w.of("test")[t]
    many = "All averaged loops miss" if len(found) == len(w.files) else f"{len(found)} of {len(w.files)} loops miss"
    at = f"{w.frequency_hz[t]:.3g} Hz and " if w.clock else ""
    return [
        f"{many} more than a right model would leave. The largest gap is at {at}{w.amplitude_mm[t]:.3g} mm "
        f"({force(worst.gap_N)} RMS)."
    ]


def _grows(w: Where) -> list[str]:
    out = []
    for kind in ("frequency", "amplitude") if w.clock else ("amplitude",):
        statistics = w.of(kind)
        if len(statistics) < 2 or not any(x.significant for x in statistics):
            continue
        sizes = np.array([x.gap_N for x in statistics])
        i, k = int(np.argmax(sizes)), int(np.argmin(sizes))
        if sizes[i] < 1.15 * sizes[k] or statistics[i].low_N <= statistics[k].high_N:
            out.append(f"The gap does not depend on {kind}: {force(sizes.min())} to {force(sizes.max())}.")
        elif i in (0, len(statistics) - 1):
            out.append(
                f"The gap {'grows' if i else 'falls'} with {kind}, from {force(sizes[0])} at {statistics[0].name} to "
                f"{force(sizes[-1])} at {statistics[-1].name}."
            )
        else:
            out.append(
                f"The gap is largest at {statistics[i].name} ({force(sizes[i])}) and smallest at {statistics[k].name} "
                f"({force(sizes[k])})."
            )
    return out


def _laws(w: Where) -> list[str]:
    out = []
    for i, law in enumerate(w.laws):
        if law.gain < LEAST_GAIN * w.laws[0].gain:
            continue
        step = "in phase with displacement" if law.part == "in phase" else "in phase with velocity"
        meaning = ""
        power = law.frequency_power
        unclear = np.ptp(np.log(w.frequency_hz)) > 0.2 if power is None else power[2] - power[1] > OPEN
        if law.order == 1 and not unclear:
            more = "stiffer" if law.part == "in phase" else "more dissipative"
            less = "softer" if law.part == "in phase" else "less dissipative"
            meaning = f": the specimen acts {more if law.force_N > 0 else less} than the model"
        grows = " and ".join(
            x for x in (_growth("frequency", law.frequency_power), _growth("amplitude", law.amplitude_power)) if x
        )
        start = "After a refit of the model's own parameters, up to" if i == 0 else "Besides, up to"
        out.append(
            f"{start} {force(_most(law, w))} is missing at the {_at(law.order, w.clock)}, {step}{meaning}"
            f"{'; it ' + grows if grows else ''}."
        )
    return out


def _most(law: GrowthLaw, w: Where) -> float:
    """The law's force in the test where it is largest, N: its own reference point may lie far outside the tests."""
    f, a = w.frequency_hz / w.frequency_hz.max(), w.amplitude_mm / w.amplitude_mm.max()
    powers = [0.0 if p is None else p[0] for p in (law.frequency_power, law.amplitude_power)]
    return abs(law.force_N) * float(np.max(f ** powers[0] * a ** powers[1]))


def _at(order: int, clock: bool) -> str:
    return "test frequency" if order == 1 and clock else _ORDINALS.get(order, f"{order}th harmonic")


def _growth(what: str, power: tuple[float, float, float] | None) -> str:
    if power is None:
        return ""
    best, low, high = power
    if high - low > OPEN:
        return ""
    for whole, words in (
        (0.0, f"does not depend on {what}"),
        (1.0, f"grows in proportion to {what}"),
        (2.0, f"grows with {what} squared"),
        (3.0, f"grows with {what} cubed"),
        (-1.0, f"falls as 1/{what}"),
    ):
        if abs(best - whole) < 0.12 or (low - 0.02 <= whole <= high + 0.02 and high - low < 0.8):
            return f"{words} (power {best:.2f}, {low:.2f} to {high:.2f})".replace("-0.00", "0.00")
    return f"goes with {what} to the power {best:.1f} ({low:.1f} to {high:.1f})"


def _harmonics(w: Where) -> list[str]:
    statistics = [x for kind in ("in phase", "quadrature") for x in w.of(kind) if x.significant and x.share > 0.1]
    if not statistics:
        return []
    statistics.sort(key=lambda x: -x.share)
    parts = [
        f"{percent(x.share)} at the {_at(int(x.name), w.clock)} in phase with "
        f"{'displacement' if x.kind == 'in phase' else 'velocity'}"
        for x in statistics[:3]
    ]
    out = [f"Of the residual's power, {joined(parts)}."]
    even = w.of("parity")[1]
    if even.significant and even.share > 0.3:
        out.append(f"{percent(even.share)} of the residual is in even harmonics: the two halves of the stroke differ.")
    return out


def _regions(w: Where) -> list[str]:
    found = [x for x in w.of("region") if x.significant and x.share > CONCENTRATED * x.time and x.share > 0.15]
    found.sort(key=lambda x: -(x.share - x.time))
    if not found:
        return ["The gap is spread evenly over the loop."] if any(x.significant for x in w.of("region")) else []
    parts = [f"{percent(x.share)} of it in {percent(x.time)} of the time ({x.name})" for x in found[:3]]
    return [f"Along the loop the gap is concentrated: {joined(parts)}."]


def _record(w: Where) -> list[str]:
    trends = [t for t, x in enumerate(w.of("trend")) if x.significant]
    whats = [x for x in w.of("record") if x.significant]
    if not trends and not whats:
        return []
    use = trends or list(range(len(w.files)))
    change = np.sqrt(np.mean(w.change_N[use] ** 2, axis=0)) * np.sign(np.sum(w.change_N[use], axis=0))
    first = _at(1, w.clock)
    names = (
        "the mean force",
        f"the {first}'s part in phase with displacement",
        f"the {first}'s part in phase with velocity",
    )
    parts = [
        f"{n} {'grows' if c > 0 else 'falls'} by {force(abs(c))}"
        for n, c, key in zip(names, change, ("mean", "in phase", "quadrature"))
        if any(x.name == key for x in whats)
    ]
    parts += [f"{x.name} change by {force(x.gap_N)} RMS" for x in whats if "harmonics" in x.name and x.share > 0.2]
    where = f"in {len(trends)} of {len(w.files)} tests" if trends else "if all tests are taken together"
    return [
        f"The loops change along the record {where}"
        f"{': ' + joined(parts) + ' from the first cycles to the last' if parts else ''}. No steady model follows "
        "that."
    ]


def _others(w: Where) -> list[str]:
    out = []
    mean = w.of("mean")[0]
    if mean.significant:
        out.append(
            f"The mean forces differ by {force(mean.gap_N)} RMS from the model's, more than an unknown rest position "
            "explains."
        )
    out += [
        f"The records hold mains interference at {x.name} of {force(x.gap_N)} RMS."
        for x in w.of("mains")
        if x.significant
    ]
    return out
