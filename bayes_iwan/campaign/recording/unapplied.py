"""What a file says of a channel, above its numbers or in its name, and nothing here applies or undoes."""

import re
from collections.abc import Iterable

from bayes_iwan.campaign.recording.records import shown

#: what has the unit of a motion or a force and is no measurement of it: never taken unless it is named
NOT_MEASURED = re.compile(
    r"\|.+\||(?<![^\W_])(error|err|fehler|abweichung|deviation|écart|command|cmd|commanded|setpoint|set[ _-]point|soll|"
    r"sollwert|sollweg|consigne|demand|energy|energie|énergie|work|arbeit|mass|masse|normal|normalkraft|preload|"
    r"abs|betrag|magnitude|rectified|rms|peak|p-?p|max|min|maximum|minimum|envelope|limit)(?![^\W\d_])",
    re.IGNORECASE,
)
#: words of what a file may state of a single channel: when it starts, what it is multiplied by
_START = re.compile(
    r"(?<![^\W_])(t0|delay|latency|skew|(start|time|trigger)[ _-]?offset)(?![^\W\d_])(?!.*\d[-./:]\d\d?[-./:]\d)|"
    r"(?<![^\W_])start\W+[\d.]+ ?(s|ms|us|sec)\b",
    re.IGNORECASE,
)
_FACTOR = re.compile(
    r"(?<![^\W_])(gain|factor|multiplier|faktor|verstärkung|sensitivity|empfindlichkeit|sensibilit[ée]|"
    r"y_?inc(?:rement)?|y_?org)(?![^\W\d_])|"
    r"(?<!vertical )(?<![^\W_])(offset|resolution|auflösung)(?![^\W\d_])(?!.*\bbits?\b)|"
    r"(?<!vertical )(?<!horizontal )(?<![^\W_])(scal(e|ing)|slope|lsb|calibration|conversion|skalierung)"
    r"\W*[=:,;\t] *[\d.]+(e[+-]?\d+)? *([^\W\d]\S*)?$",
    re.IGNORECASE,
)
#: a filter, by the parts that its words share in many languages
_FILTER = re.compile(
    r"(?:filt|smooth|glätt|lissé|lissage|(?:low|high|band|tief|hoch)[ -]?pass|cut-?off|grenzfreq|moving[ _-]?av|"
    r"averaging|фильтр|滤波|フィルタ)(?!\w*\W*(?:off|none|no|aus)\b(?!.*hz))",
    re.IGNORECASE,
)
_NUMBERS = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
#: within a channel's name a number of a factor, an offset, a delay or a filter (1000*Force, Force x 1e3, gain 10, 4 ms
#: late, 100 Hz), and a filter's or mean's word
_N = r"\d+(?:[.,]\d+)?(?:e[+-]?\d+|\^\d+)?"
_IN_NAME = re.compile(
    rf"(?<![\d\s])\s*[*×·/=] ?({_N})\)?(?!\w)|[^\W_][\s_(]+[x×] ?({_N})(?![^\W_])|"
    rf"(?<![^\W_])({_N}) ?(?:[*×·]|x(?![^\W_]))|[+] ?({_N})|"
    rf"(?<![^\W_])(?:[hlt]p ?)?({_N}[ _]?(?:[mµu]?s|sec|samples?|k?hz))(?![^\W_])|^(\d+/\d+)(?=[ *])|"
    r"(?<![^\W_])(?:gain|factor|faktor|scal\w*|amp\w*|mul\w*|times|mal|by|verst\w*|cal\w*|offset|tare|delay\w*|lag\w*|"
    rf"[hlt]p)[\W_]*({_N})|"
    rf"({_FILTER.pattern}|mittelt|mittelwert|(?<![^\W_])(?:[hlt]p|running|mean|m?avg|averaged?)(?![^\W_]))",
    re.IGNORECASE,
)


def not_applied(stated: Iterable[str]) -> tuple[str, ...]:
    """Warnings of statements ("Force delay: 0.008 s", "Gain = 10") that would shift, scale or filter one channel:
    whether they are in the numbers already no file says. Starts of 0 and factors of 1 change nothing."""
    out = []
    for text in stated:
        for pattern, neutral, fix in (
            (_START, (0.0,), "applied: a channel that starts late needs its own time column"),
            (_FACTOR, (0.0, 1.0), "applied: if the numbers do not hold it yet, say so with --gain or --unit"),
            (_FILTER, (0.0,), "undone: both channels need one filter, far above the drive"),
        ):
            if pattern.search(text) and any(float(x) not in neutral for x in _NUMBERS.findall(text)):
                out.append(f"the file states {shown(' '.join(text.split()))}, which is not {fix}")
                break
    return tuple(dict.fromkeys(out))


def said_of_name(name: str, others: Iterable[str]) -> tuple[str, ...]:
    """A warning of a name that says of a used channel what changes its numbers (Force x10, 4 ms late, |F|, LP 100 Hz).

    others : all channels' names, which tell an axis or number (Accel x1, Accel x2).
    """
    if NOT_MEASURED.search(name):
        return (f"{name!r} is no force or motion as it was measured, by its name: the loop is wrong if that is so",)
    found = [x for groups in _IN_NAME.findall(name) for x in groups if not re.fullmatch(r"[01]?(?:[.,]0*)?", x)]
    stem = re.sub(r"[xyz]?\d+", "", name)
    if not found or any(x != name and re.sub(r"[xyz]?\d+", "", x) == stem for x in others):
        return ()
    return (
        f"{name!r} may name a factor, an offset, a delay or a filter, which is neither applied nor undone: scale the "
        "numbers if they do not hold a factor yet (--gain, --unit), and take a channel without filter and on time",
    )
