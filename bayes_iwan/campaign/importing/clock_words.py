"""Words by which files of all formats state sample rates, steps of time and starts, and what they state."""

import re
from collections.abc import Iterable

from bayes_iwan.campaign.importing.recordings import RATES_HZ
from bayes_iwan.campaign.importing.unit_texts import decimal_point

_RATES = (
    r"sampl\w*[ _-]*(?:rate|freq\w*)|(?:scan|data|acquisition|acq\.?|storage|record(?:ing)?|log(?:ging)?)[ _-]*rate|"
    r"abtast(?:rate|frequenz)|messrate|fr[ée]quence d.[ée]chantillonnage|"
    r"frequenza di campionamento|frecuencia de muestreo|采样(?:率|频率)|"
    r"サンプリング周波数|частота дискретизации|fs|fsample|srate"
)
_STEPS = (
    r"(?:sampl\w*|scan|time|x|h|wf)?[ _-]*(?:interval|increment)|(?:sampl\w*|scan)[ _-]*(?:period|step|cycle)|"
    r"time[ _-]?step|(?:sampl\w*|time|x|h)[ _-]*resolution|d[tx]|delta[ _-]?[tx]|[tx][ _-]?delta|"
    r"(?:abtast|zeit)[ _-]?(?:intervall|schritt|periode)|サンプリング間隔|采样间隔|t[ _]?inc|ts"
)
_STARTS = r"(?:wf[ _-])?start[ _-]?(?:times?|offset|value)|t[ _]?(?:0|start)|start(?=_s)|h[ _-]?offset|x0"
#: of a label that is nothing else, as of an array of MATLAB or a row above a table
STARTS, STEPS = (re.compile(rf"(?:{x})(?:_s)?", re.IGNORECASE) for x in (_STARTS, _STEPS))
_HINT = (
    r"[^\w]*(?:{})[\W_]{{0,2}}(?P<u1>k?hz|k?s/s|m?s|[uµμn]s|sec\w*)?[\])]?\"?\s*[:=;,\t ]\s*\"?"
    r"(?P<v>\d[\d.,]*(?:e[+-]?\d+)?)\s*(?P<u2>[a-zµμ/]*)"
)
_RATE_HINT, _STEP_HINT = (re.compile(_HINT.format(x), re.IGNORECASE) for x in (_RATES, _STEPS))
#: the unit of a step in a line of its own; and that not all samples of a stated rate were kept
_STEP_UNIT = re.compile(
    r"\W*(?:x|h|t|time|zeit|horizontal|abscissa)[ _-]*(?:axis[ _-]*)?(?:units?|einheit)\W+([a-zµμ]+)", re.IGNORECASE
)
_THINNED = re.compile(
    r"\b(?:decimat\w*|reduc\w*|down[ _-]?sampl\w*|averag(?:ing|es))\W*(?:(?:factor|ratio|by)\W*)*(?!1\b)\d|"
    r"\bevery \d+ ?(?:st|nd|rd|th|samples|points|scans|rows|values)\b",
    re.IGNORECASE,
)
_OF_LENGTH = re.compile(r"\W*(dx|resolution|interval)\b", re.IGNORECASE)
_PER_SECOND = {"khz": 1e3, "mhz": 1e6, "ks/s": 1e3, "ksa/s": 1e3, "ms/s": 1e6, "msa/s": 1e6}
_SECONDS = {"ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "msec": 1e-3, "usec": 1e-6}


def stated_rate(lines: Iterable[str]) -> float | None:
    """Samples a second that lines ("Sample interval: 2 ms", "fs = 500") state; None for none, or several.

    None too where not all samples were kept, and for a step of 1 or more without a unit, which is as often in ms.
    """
    lines, found = list(lines), set()
    if any(map(_THINNED.search, lines)):
        return None
    of_step = next((m[1] for m in map(_STEP_UNIT.match, lines) if m), "")
    for line in lines:
        for hint, table, turn in ((_RATE_HINT, _PER_SECOND, False), (_STEP_HINT, _SECONDS, True)):
            m = hint.match(line)
            if not m or re.search(r"(?:/|per) *(?:min|h)", line):
                continue
            try:
                value = float(decimal_point(m["v"].rstrip(".,")))
            except ValueError:
                continue
            unit = (m["u2"] or m["u1"] or (of_step if turn else "")).lower()
            if not turn and unit in _SECONDS | {"s": 1.0, "sec": 1.0}:
                turn, table = True, _SECONDS
            in_seconds = unit in _SECONDS or re.match(r"s(ec|$)", unit) if unit else not _OF_LENGTH.match(line)
            if turn and (not in_seconds or (not unit and value >= 1)):
                continue  # of a length, of a converter, or of nobody knows what
            value *= table.get(unit, 1.0)
            rate = 1 / value if turn and value else value
            if RATES_HZ[0] < rate < RATES_HZ[1]:
                found.add(float(f"{rate:.9g}"))
    return found.pop() if len(found) == 1 else None


def rate_of_step(step: float, lines: Iterable[str]) -> float | None:
    """The same of one channel's step, whose unit lines may hold."""
    return stated_rate([f"dt = {step!r}", *(x for x in lines if _STEP_UNIT.match(x) or _THINNED.search(x))])
