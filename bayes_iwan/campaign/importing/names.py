"""Words by which a channel's name says what it is, in the languages of measuring programs."""

import re

#: words that begin a word in a channel's name; a letter counts where no word says anything
WORDS = {
    "time": r"time|date_?time|timestamps?|zeit|uhrzeit|temps|tempo|tiempo|tijd|czas|čas|zaman|врем\w+|t|x_value|"
    r"millis|micros",
    "displacement": r"disp|displ|displacement|weg|position|pos|stroke|hub|lvdt|laser|auslenkung|verschiebung"
    r"|deplacement|déplacement|spostamento|desplazamiento|angle|winkel|drehwinkel|rotation|x|u|extension"
    r"|перемещ\w+|деформац\w+|verplaatsing|przemieszczenie",
    "acceleration": r"acc|accel|accelerometer|acceleration|accélération|accelerazione|aceleración|beschl|beschleunigung"
    r"|a|ускорен\w+",
    "force": r"force|kraft|load|last|fz|fx|fy|f|torque|moment|drehmoment|couple|coppia|pressure|druck|pression|fuerza"
    r"|forza|effort|сил[аы]|усили\w+|нагрузк\w+|kracht|siła",
}
#: of languages that write words without blanks between them
_WITHIN = {
    "time": "时间|時間|時刻|시간",
    "displacement": "位移|変位|변위|行程",
    "acceleration": "加速度|가속도",
    "force": "(?<![应応])力|载荷|載荷|荷载|荷重|하중",
}


def named(name: str, role: str) -> bool:
    """Whether a name says that a channel is of a role; of `laser.t` the last part, unless that says nothing or is an
    axis (`wrench.force.x`)."""
    timed = re.match(r"t[ _](?=\w\w)", name, re.IGNORECASE) or _has_word(name, "time")
    if timed and any(_has_word(name, other) for other in WORDS):
        return role == "time"  # t_disp, Data1_time_Weg: a channel's own
    stem, _, leaf = name.rpartition(".")
    axis = leaf in ("x", "y", "z") and any(_has_word(stem, other) for other in WORDS)
    return _says(leaf if any(_says(leaf, other) for other in WORDS) and not axis else name, role)


def _says(name: str, role: str) -> bool:
    """By a word, or by a letter at its start where there is no word."""
    if _has_word(name, role):
        return True
    letters = "|".join(w for w in WORDS[role].split("|") if len(w) == 1)
    if not letters or any(_has_word(name, other) for other in WORDS):
        return False
    return bool(re.match(rf"({letters})(?![^\W\d_])", name, re.IGNORECASE))


def _has_word(name: str, role: str) -> bool:
    longer = "|".join(w for w in WORDS[role].split("|") if len(w) > 1)
    return bool(re.search(rf"(?<![^\W_])({longer})(?![^\W\d_])|{_WITHIN[role]}", name, re.IGNORECASE))
