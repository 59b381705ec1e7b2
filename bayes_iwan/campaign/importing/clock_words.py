"""Words by which files of all formats state sample rates, steps of time and starts, and what they state."""

import math
import re
from collections.abc import Iterable

from bayes_iwan.campaign.importing.recordings import RATES_HZ, only_rate

_SAMPLING = r"(?:sampl\w*|scan(?:ning)?|data|daq|adc|acq\w*\.?|storage|record(?:ing)?|log(?:ging)?|output|abtast|mess)"
#: the same behind the noun, in languages that put it there
_OF_SAMPLING = (
    r"[ -](?:d[ei] |d['’]|по )?(?:[ée]chantillonnage|acquisition|campionamento|acquisizione|muestreo|adquisici[óo]n|"
    r"temps|дискретизации|опроса|времени)"
)
_PER_S = r"(?:s|sa|sam\w*|scans?|points?|readings?|rows?|values?)[ _]?(?:/|per) ?(?:channel per )?s(?:ec(?:ond)?s?)?"
_RATES = (
    rf"(?:{_SAMPLING}[ _-]*){{1,3}}(?:rate|fre[qk]\w*\.?)(?:[ _-]per[ _-]ch\w*)?|"
    rf"(?:fr[ée]q\w*|frec\w*|tasa|taux|частота)\.?{_OF_SAMPLING}|"
    rf"(?:采样|サンプリング)(?:率|频率|周波数|レート)|f_?s(?:ample)?|srate|(?:(?:number|no\.?) of )?{_PER_S}"
)
#: what counts beside a unit of rates alone; a bare rate in Hz is as often the drive's
_VAGUE = r"(?P<bare>rate)|s_?r|(?:sampled|recorded|logged|acquired|sampling)(?: at| with| @)?"
_STEPS = (
    rf"(?:{_SAMPLING}|time|x|h|horizontal|wf)?[ _-]*(?:interval|increment)|x_?incr?|"
    r"(?:sampl\w*|scan)[ _-]*(?:period|step|cycle|time)|time[ _-]?step|(?:sampl\w*|time|x|h)[ _-]*resolution|"
    r"(?:one |a )?(?:sam\w*|scans?|points?|readings?|rows?) every|d[tx]|(?:delta|δ)[ _-]?[tx]|[tx][ _-]?delta|"
    r"(?:abtast|zeit)[ _-]?(?:intervall|schritt|periode|zeit)|"
    rf"(?:pas|p[ée]riod[eo]|interval\w*|paso|шаг|период|интервал){_OF_SAMPLING}|"
    r"(?:サンプリング|采样)(?:間隔|间隔|周期)|t[ _]?inc|t_?s"
)
_STARTS = r"(?:wf[ _-])?start[ _-]?(?:times?|offset|value)|t[ _]?(?:0|start)|start(?=_s)|h[ _-]?offset|x0"
#: of a label that is nothing else, as of an array of MATLAB or a row above a table
STARTS, STEPS = (re.compile(rf"(?:{x})(?:_s)?", re.IGNORECASE) for x in (_STARTS, _STEPS))
#: units of rates and of steps, and what their prefixes mean
_HERTZ, _SECONDS = (
    re.compile(x, re.IGNORECASE)
    for x in (
        rf"([kmgкм]?)(?:hz|hertz|гц|sps|1?/s|per s\w*|{_PER_S})(?:/ch\w*)?",
        r"(milli|micro|[mµμunм]?)(?:s|sec\w*|sek\w*|с|сек)",
    )
)
_PER_SECOND = {"": 1.0, "k": 1e3, "к": 1e3, "m": 1e6, "м": 1e6, "g": 1e9}
_OF_A_SECOND = {"": 1.0, "milli": 1e-3, "m": 1e-3, "м": 1e-3, "micro": 1e-6, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9}
_UNIT = rf"({_HERTZ.pattern}|{_SECONDS.pattern})"
_RATE, _VAGUE_RATE, _STEP = (
    re.compile(rf"\W*(?:{x})[\W_]{{0,2}}{_UNIT}?\W*", re.IGNORECASE) for x in (_RATES, _VAGUE, _STEPS)
)
#: where a statement begins in a line; its label, its number and what stands behind; the unit there
_BEGINS = re.compile(r"^|[;\t|]|,(?=\s*[^\s\d])")
_NUMBER = re.compile(r"(.{0,80}?)(?<![\w/\[({.-])(\d+(?:[.,]\d+)*(?:e[+-]?\d+)?)(.{0,400})", re.IGNORECASE)
_MORE = re.compile(rf"(?:[\s;|'’]+\d[\d.,]*(?:e[+-]?\d+)?\s*{_UNIT}?(?=[\s;|'’]|$))*", re.IGNORECASE)
_BEHIND = re.compile(rf"[\"\s;,\[(]*{_UNIT}(?![\w/])|\s*(?P<other>[^\W\d_]+|[°%])", re.IGNORECASE)
#: the unit of a step in a line of its own; and that not all samples of a stated rate were kept
_STEP_UNIT = re.compile(
    r"\W*(?:x|h|t|time|zeit|horizontal|abscissa)[ _-]*(?:axis[ _-]*)?(?:units?|einheit)\W+([a-zµμ]+)", re.IGNORECASE
)
THINNED = re.compile(
    r"\b(?:decimat\w*|reduc\w*|(?:down|over)[ _-]?sampl\w*|averag\w*)\W*(?:(?:factor|ratio|by)\W*)*(?!1\b)\d+(?![.,\w])"
    r"|\bevery \d+ ?(?:st|nd|rd|th|samples|points|scans|rows|values)\b",
    re.IGNORECASE,
)
_SAMPLES_PER_S = re.compile(rf"[kmg]?(?:{_PER_S})", re.IGNORECASE)
_LENGTH = re.compile(r"\W*(dx|resolution|interval)\b", re.IGNORECASE)
_DURATION = re.compile(r"\W*(sampl\w*|scan|abtast)[ _-]*(time|zeit)", re.IGNORECASE)  # as well as a step


def stated_rates(lines: Iterable[str], decimal: str = ".") -> tuple[float, ...]:
    """Samples a second that lines ("Sample interval: 2 ms", "fs = 500") state, NaN where some are not known.

    decimal : the mark of the file's other numbers, "" where they show none. No rate is stated where not all samples
    were kept, and by a step of 1 or more without a unit, which is as often in ms.
    """
    lines = list(lines)
    if any(map(THINNED.search, lines)):
        return ()
    of_step = next((m[1] for m in map(_STEP_UNIT.match, lines) if m), "")
    every = (m for x in lines for at in _BEGINS.finditer(x) if (m := _NUMBER.match(x, at.end())))
    rates = (_one_rate(m, value, of_step) for m in every for value in _values(m[2], decimal))
    found = {float(f"{x:.9g}") for x in rates if x is not None}
    return tuple(sorted(x for x in found if not x <= RATES_HZ[0] and not x >= RATES_HZ[1]))


def _values(number: str, decimal: str) -> list[float]:
    """What a number may be: two where a mark before three digits is not the file's decimal mark and may divide
    thousands, none where it has several marks."""
    try:
        value = float(number.replace(",", "."))
    except ValueError:
        return []
    thousands = re.fullmatch(r"[1-9]\d{0,2}([.,])\d{3}", number)
    return [value, 1e3 * value] if thousands and thousands[1] != decimal else [value]


def _one_rate(stated: re.Match[str], value: float, of_step: str) -> float | None:
    """Samples a second that a label, a number of some value and what stands behind it state; None where they state
    none, NaN where they state several."""
    label, number, after = stated.groups()
    kind, found = next(((k, x) for k in (_RATE, _STEP, _VAGUE_RATE) if (x := k.fullmatch(label))), (None, None))
    behind = _BEHIND.match(after)
    unit = (behind and behind[1]) or (found and found[1]) or (of_step if kind is _STEP else "")
    rate, step = _HERTZ.fullmatch(unit), _SECONDS.fullmatch(unit)
    if re.search(r"(?:/|per) *(?:min|h)", after) or not (
        found or (_SAMPLES_PER_S.fullmatch(unit) and not label.strip())
    ):
        return None
    more = _MORE.match(after[behind.end() if behind and behind[1] else 0 :])
    if more and any(x != number for x in re.findall(r"(?i)(?<![\w.,+-])\d[\d.,]*(?:e[+-]?\d+)?", more[0])):
        return math.nan  # each channel has its own, or 1 000 is meant
    if rate and found and kind is _VAGUE_RATE and found["bare"] and not (rate[1] or _SAMPLES_PER_S.fullmatch(unit)):
        return None
    if rate:
        return value * _PER_SECOND[rate[1].lower()]
    if step:
        value *= _OF_A_SECOND[step[1].lower()]
    elif (
        (behind and behind["other"]) or kind is _VAGUE_RATE or (kind is _STEP and (value >= 1 or _LENGTH.match(label)))
    ):
        return None  # of a length, of a converter, of the drive, or of nobody knows what
    elif kind is _RATE:
        return value
    return None if value == 0 or (value >= 1 and _DURATION.match(label)) else 1 / value


def rate_of_step(step: float, lines: Iterable[str]) -> float | None:
    """The same of one channel's step, whose unit lines may hold."""
    return only_rate(stated_rates([f"dt = {step!r}", *(x for x in lines if _STEP_UNIT.match(x) or THINNED.search(x))]))
