"""Size and place of the gap as plain sentences, as JSON and as arrays for pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.gap.fitting.gap_size import GapSize
from bayes_iwan.gap.fitting.residuals import Residual
from bayes_iwan.gap.telling.laws import GrowthLaw
from bayes_iwan.gap.telling.where import Statistic, Where

#: a part of the loop is worth a sentence when its share of the gap is this many times its share of the time
CONCENTRATED = 1.25
#: and a law when it explains this share of what the first explains
WORTH = 0.01
#: a power whose interval is wider than this is not reported; nor then is the sign of what is missing
OPEN = 2.0
_ORDINALS = {1: "fundamental", 2: "second harmonic", 3: "third harmonic"}


def newtons(x: float) -> str:
    """A force to two digits, in kN, N or mN."""
    scale, unit = (1e3, "kN") if x >= 1e3 else (1.0, "N") if x >= 0.01 else (1e-3, "mN")
    return f"{float(f'{x / scale:.2g}'):g} {unit}"


def where_sentences(where: Where) -> list[str]:
    """One sentence for each finding, in plain words; a single one where nothing stands out."""
    out = [
        *_tests(where),
        *_grows(where),
        *_laws(where),
        *_harmonics(where),
        *_regions(where),
        *_record(where),
        *_rest(where),
    ]
    if not out:
        return [
            f"Nothing stands out: in none of {where.count} statistics is the gap larger than noise, the parameters' "
            "uncertainty and the small misfit that specimens without any missing cause show."
        ]
    return [
        *out,
        f"{where.count} statistics were taken. Each finding above would still be one were the model right in "
        "fewer than 1 of 20 campaigns, all statistics together.",
    ]


def where_json(where: Where, size: GapSize) -> dict[str, Any]:
    """The "where" of a diagnosis as plain numbers."""
    kinds = {
        k: where.of(k)
        for k in (
            "test",
            "trend",
            "region",
            "frequency",
            "amplitude",
            "parity",
            "mean",
            "record",
            "mains",
            "in phase",
            "quadrature",
        )
    }
    tests = []
    for t, name in enumerate(where.files):
        g, found = size.tests[t], kinds["test"][t].significant or kinds["trend"][t].significant
        tests.append(
            {
                "file": name,
                "frequency_hz": float(where.frequency_hz[t]),
                "amplitude_mm": float(where.amplitude_mm[t]),
                "gap_rms_N": g.rms_N,
                "interval_N": [g.low_N, g.high_N],
                "share": g.share,
                "significant": found,
                "along_record_N": kinds["trend"][t].gap_N,
                "along_record_significant": kinds["trend"][t].significant,
            }
        )
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
        for h, (p, q) in enumerate(zip(kinds["in phase"], kinds["quadrature"]))
    ]
    return {
        "statistics": where.count,
        "tests": tests,
        "regions": [_statistic(x, "region") for x in kinds["region"]],
        "harmonics": harmonics,
        "by_frequency": [_statistic(x, "frequency") for x in kinds["frequency"]],
        "by_amplitude": [_statistic(x, "amplitude") for x in kinds["amplitude"]],
        "parity": [_statistic(x, "parity") for x in kinds["parity"]],
        "mean": _statistic(kinds["mean"][0], "what"),
        "along_record": [_statistic(x, "what") for x in kinds["record"]],
        "mains": [_statistic(x, "line") for x in kinds["mains"]],
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


@dataclass(frozen=True)
class GapPictures:
    """What :mod:`bayes_iwan.report.diagnosis.gap_figures` draws of the gap of T tests.

    names : of the tests; frequency_hz, amplitude_mm : (T,)
    displacement_mm, force_N, residual_N, expected_N, sticking : (T, n) along the cycle: measured, measured − predicted,
        what noise and a right model's usual misfit would leave, the share of sliders that stick
    in_phase_N, quadrature_N, expected_harmonic_N : (T, H) harmonics of the residual
    gap_N, gap_low_N, gap_high_N, friction_N : (T,) RMS with its 90 % interval, RMS friction force
    significant : (T,) whether it is more than a right model would leave
    cycle, along_N, along_low_N, along_high_N : by test, (B,) mean cycle of a block and RMS of what is missed there
    regions : parts of the loop
    """

    names: tuple[str, ...]
    frequency_hz: Array
    amplitude_mm: Array
    displacement_mm: Array
    force_N: Array
    residual_N: Array
    expected_N: Array
    sticking: Array | None
    in_phase_N: Array
    quadrature_N: Array
    expected_harmonic_N: Array
    gap_N: Array
    gap_low_N: Array
    gap_high_N: Array
    significant: NDArray[np.bool_]
    friction_N: Array
    cycle: tuple[Array, ...]
    along_N: tuple[Array, ...]
    along_low_N: tuple[Array, ...]
    along_high_N: tuple[Array, ...]
    regions: tuple[Statistic, ...]


def pictures(residual: Residual, where: Where, size: GapSize) -> GapPictures:
    """What is drawn of a gap."""
    loops, shown = residual.data.loops, zip(where.of("test"), where.of("trend"))
    return GapPictures(
        names=tuple(f"{x.record.frequency_hz:g} Hz, {x.record.amplitude_mm:g} mm" for x in loops),
        frequency_hz=where.frequency_hz,
        amplitude_mm=where.amplitude_mm,
        displacement_mm=np.stack([x.displacement_mm for x in loops]),
        force_N=np.stack([x.force_N for x in loops]),
        residual_N=where.phase_N,
        expected_N=where.expected_N,
        sticking=where.sticking,
        in_phase_N=where.in_phase_N,
        quadrature_N=where.quadrature_N,
        expected_harmonic_N=where.expected_harmonic_N,
        gap_N=np.array([g.rms_N for g in size.tests]),
        gap_low_N=np.array([g.low_N for g in size.tests]),
        gap_high_N=np.array([g.high_N for g in size.tests]),
        significant=np.array([x.significant or y.significant for x, y in shown]),
        friction_N=size.friction_N,
        cycle=size.cycle,
        along_N=size.along_N,
        along_low_N=size.along_low_N,
        along_high_N=size.along_high_N,
        regions=tuple(where.of("region")),
    )


def _statistic(x: Statistic, key: str) -> dict[str, Any]:
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


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"


def _tests(w: Where) -> list[str]:
    found = [x for x in w.of("test") if x.significant]
    if not found:
        return []
    t = int(np.argmax([x.gap_N for x in w.of("test")]))
    worst = w.of("test")[t]
    many = "Every test's" if len(found) == len(w.files) else f"{len(found)} of {len(w.files)} tests'"
    return [
        f"{many} averaged loops show more than a right model would leave; most is missed at "
        f"{w.frequency_hz[t]:.3g} Hz and {w.amplitude_mm[t]:.2g} mm ({newtons(worst.gap_N)} RMS)."
    ]


def _grows(w: Where) -> list[str]:
    out = []
    for kind in ("frequency", "amplitude"):
        statistics = w.of(kind)
        if len(statistics) < 2 or not any(x.significant for x in statistics):
            continue
        sizes = np.array([x.gap_N for x in statistics])
        i, k = int(np.argmax(sizes)), int(np.argmin(sizes))
        if sizes[i] < 1.15 * sizes[k] or statistics[i].low_N <= statistics[k].high_N:
            out.append(f"It does not depend on {kind}: {newtons(sizes.min())} to {newtons(sizes.max())}.")
        elif i == len(statistics) - 1:
            out.append(
                f"It grows with {kind}, from {newtons(sizes[0])} at {statistics[0].name} to {newtons(sizes[-1])} at "
                f"{statistics[-1].name}."
            )
        elif i == 0:
            out.append(
                f"It falls with {kind}, from {newtons(sizes[0])} at {statistics[0].name} to {newtons(sizes[-1])} at "
                f"{statistics[-1].name}."
            )
        else:
            out.append(
                f"It is largest at {statistics[i].name} ({newtons(sizes[i])}) and smallest at {statistics[k].name} "
                f"({newtons(sizes[k])})."
            )
    return out


def _laws(w: Where) -> list[str]:
    out = []
    for i, law in enumerate(w.laws):
        if law.gain < WORTH * w.laws[0].gain:
            continue
        step = "in step with the displacement" if law.part == "in phase" else "in step with the velocity"
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
        start = "Once the model's own parameters may adapt," if i == 0 else "Beside that,"
        out.append(
            f"{start} what is missing at the {_ordinal(law.order)} {step} "
            f"is {newtons(_most(law, w))} at most in these tests{meaning}"
            f"{'; it ' + grows if grows else ''}."
        )
    return out


def _most(law: GrowthLaw, w: Where) -> float:
    """The law's force in the test where it is largest, N: its own reference point may lie far outside the tests."""
    f, a = w.frequency_hz / w.frequency_hz.max(), w.amplitude_mm / w.amplitude_mm.max()
    powers = [0.0 if p is None else p[0] for p in (law.frequency_power, law.amplitude_power)]
    return abs(law.force_N) * float(np.max(f ** powers[0] * a ** powers[1]))


def _ordinal(order: int) -> str:
    return _ORDINALS.get(order, f"{order}th harmonic")


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
        f"{_percent(x.share)} in the {_ordinal(int(x.name))} in step with the "
        f"{'displacement' if x.kind == 'in phase' else 'velocity'}"
        for x in statistics[:3]
    ]
    out = [f"Of the residual's power {_listed(parts)}."]
    even = w.of("parity")[1]
    if even.significant and even.share > 0.3:
        out.append(
            f"{_percent(even.share)} of it is in even harmonics: the two halves of the stroke are missed differently."
        )
    return out


def _regions(w: Where) -> list[str]:
    found = [x for x in w.of("region") if x.significant and x.share > CONCENTRATED * x.time and x.share > 0.15]
    found.sort(key=lambda x: -(x.share - x.time))
    if not found:
        return ["It is spread evenly over the loop."] if any(x.significant for x in w.of("region")) else []
    return [f"Along the loop it is concentrated: {_listed([_region(x) for x in found[:3]])}."]


def _region(x: Statistic) -> str:
    return f"{_percent(x.share)} of it in {_percent(x.time)} of the time ({x.name})"


def _record(w: Where) -> list[str]:
    trends = [t for t, x in enumerate(w.of("trend")) if x.significant]
    whats = [x for x in w.of("record") if x.significant]
    if not trends and not whats:
        return []
    use = trends or list(range(len(w.files)))
    change = np.sqrt(np.mean(w.change_N[use] ** 2, axis=0)) * np.sign(np.sum(w.change_N[use], axis=0))
    names = (
        "the mean force",
        "the fundamental in step with the displacement",
        "the fundamental in step with the velocity",
    )
    parts = [
        f"{n} {'grows' if c > 0 else 'falls'} by {newtons(abs(c))}"
        for n, c, key in zip(names, change, ("mean", "in phase", "quadrature"))
        if any(x.name == key for x in whats)
    ]
    parts += [f"{x.name} change by {newtons(x.gap_N)} RMS" for x in whats if "harmonics" in x.name and x.share > 0.2]
    where = f"in {len(trends)} of {len(w.files)} tests" if trends else "if all tests are taken together"
    return [
        f"The loops change along the record {where}, which no steady model can "
        f"follow{': ' + _listed(parts) + ' from the first cycles to the last' if parts else ''}."
    ]


def _rest(w: Where) -> list[str]:
    out = []
    mean = w.of("mean")[0]
    if mean.significant:
        out.append(
            f"The mean forces differ by {newtons(mean.gap_N)} RMS from the model's, more than an unknown place "
            "of rest explains."
        )
    out += [
        f"Beside the loops the records hold a line at {x.name} of {newtons(x.gap_N)} RMS: the mains."
        for x in w.of("mains")
        if x.significant
    ]
    return out


def _listed(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + " and " + parts[-1]
