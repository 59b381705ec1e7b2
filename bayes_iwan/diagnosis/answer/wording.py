"""Names and numbers of a diagnosis as they stand in running text."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from bayes_iwan.effects.catalogue import UNLISTED
from bayes_iwan.effects.law_families import LOST

#: names that a list in running text holds; the others are counted
MOST_NAMES = 3

TITLES = {
    "channel_delay": "a delay between the channels",
    "mains_interference": "mains interference",
    "maxwell_branch": "a Maxwell branch",
    "force_highpass": "a high-pass in the force channel",
    "force_lowpass": "a low-pass in the force channel",
    "integration_highpass": "a high-pass of the integration",
    "force_clipping": "a limit of the force",
    "stribeck_weakening": "Stribeck weakening",
    "slip_forces_free": "another distribution of slip forces",
    "stiffness_law_free": "another law of the stiffness",
    "normal_force_free": "another law of the normal force",
    "speed_dependent_normal_force": "a normal force that grows with speed",
    "varying_normal_force": "a normal force that changes with displacement",
    "stiffness_of_normal_force": "a stiffness that follows the normal force",
    "mixture_of_slip_forces": "a mixture of slip forces",
    "direction_dependent_friction": "direction-dependent friction",
    "none": "no effect",
    "unknown": "an unknown cause",
}


def title(name: str) -> str:
    """An effect's name in running text."""
    what, follows, condition = name.partition("_follows_")
    if follows:
        verb = "follow" if what == "slip_forces" else "follows"
        return f"{what.replace('_', ' ')} that {verb} {condition}"
    return TITLES.get(name, name.replace("_", " "))


def capital(text: str) -> str:
    """The text as a sentence begins."""
    return text[:1].upper() + text[1:]


def joined(words: Sequence[str], last: str = "and") -> str:
    """Words or parts of a sentence as a list in running text."""
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + f" {last} " + words[-1]


def listed(names: Sequence[str], last: str = "and") -> str:
    """Names of effects in running text, all of them."""
    return joined([title(n) for n in names], last)


def few(names: Sequence[str], last: str = "or") -> str:
    """The same, the first MOST_NAMES by name and the others as a number."""
    more = len(names) - MOST_NAMES
    if more < 1:
        return listed(names, last)
    return f"{', '.join(map(title, names[:MOST_NAMES]))} {last} {more} other{'s' if more > 1 else ''}"


def force(newton: float | None) -> str:
    """A force to three digits in kN, N or mN; a dash for what is not known."""
    if newton is None or newton != newton:
        return "–"
    size = abs(newton)
    if size == 0.0 or size >= 1e6:
        return f"{newton:.3g} N" if size == 0.0 else f"{newton / 1e3:,.0f} kN"
    scale, unit = (1e3, "kN") if size >= 999.5 else (1.0, "N") if size >= 0.0995 else (1e-3, "mN")
    return f"{plain(newton / scale)} {unit}"


def plain(x: float | None, digits: int = 3) -> str:
    """A number to so many digits without an exponent; a dash for what is not known."""
    if x is None or x != x:
        return "–"
    if x == 0.0 or not np.isfinite(x):
        return f"{x:g}"
    return np.format_float_positional(float(f"{x:.{digits}g}"), trim="-")


def percent(share: float | None) -> str:
    """A share in percent: two digits below a tenth, nothing below 0.01 %; a dash for what is not known."""
    if share is None or share != share:
        return "–"
    text = f"{100 * share:.2g}" if 0.0001 <= abs(share) < 0.0995 else f"{100 * share:.0f}"
    return ("0" if text == "-0" else text) + " %"


def interval(pair: Sequence[float] | None, said: Callable[[float], str]) -> str:
    """Both ends of an interval, or a dash."""
    return "–" if not pair else f"{said(pair[0])} to {said(pair[1])}"


def probability(p: float) -> str:
    return f"{p:.2f}"


def value_of(name: str, mean: float, sd: float, unit: str) -> str:
    """A parameter with its standard deviation: " of 1.5 ± 0.1 N·s/mm", or " (drop 0.3 ± 0.1)" where it has no unit."""
    what = name.split("[")[0].replace("_", " ")
    if name == LOST and mean < 0.0:
        what, mean = what.replace("lost", "regained"), -mean
    number = f"{plain(mean)} ± {plain(sd, 1)}"
    return f" of {number} {unit}" if unit not in ("-", "") else f" ({what} {number})"


def strength(parameters: Mapping[str, tuple[float, float, str]]) -> str:
    """The first of an effect's parameters, (mean, sd, unit) by name."""
    for name, (mean, sd, unit) in parameters.items():
        return value_of(name, mean, sd, unit)
    return ""


def odds(log_odds: float) -> str:
    """Odds from their logarithm."""
    return "over 1000 : 1" if log_odds > 6.9 else f"{np.exp(log_odds):.{0 if log_odds > 2.3 else 1}f} : 1"


def physics_of_pattern(resembles: str | None) -> str | None:
    """What a pattern without a cause stands for, in words."""
    return next((e.physics for e in UNLISTED if e.name == resembles), None)
