"""The answer in plain words, from the dictionary that `diagnosis.json` holds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

TITLES = {
    "channel_delay": "a delay between the channels",
    "viscous_damping": "viscous damping",
    "none": "no effect outside the model",
    "unknown": "something outside the catalogue",
}


def title(name: str) -> str:
    """An effect's name in running text."""
    return TITLES.get(name, name.replace("_", " "))


def sentences(d: dict[str, Any]) -> list[str]:
    """The answer: how large the gap is, what makes it, what is left, what to do."""
    return [_size(d["gap"]), *_which(d), *_rest(d), *_remedies(d), _next(d)]


def _size(gap: dict[str, Any]) -> str:
    low, high = gap["before_interval_N"]
    if low <= 0.0:
        return (
            f"The gap between measurement and model is zero within its interval: at most {force(high)} RMS, "
            f"{_percent(gap['before_share_interval'][1])} of the friction force, beyond the records' own noise of "
            f"{force(gap['noise_rms_N'])}."
        )
    return (
        f"The model misses {force(gap['before_rms_N'])} RMS ({force(low)} to {force(high)}), "
        f"{_percent(gap['before_share'])} of the friction force, beyond the records' own noise of "
        f"{force(gap['noise_rms_N'])}."
    )


def _which(d: dict[str, Any]) -> list[str]:
    verdict = d["verdict"]
    if verdict["kind"] == "none":
        p = d["probabilities"]["none"]
        doubt = [c["name"] for c in d["considered"]]
        tail = f"; {listed(doubt)} cannot be excluded" if doubt else ""
        return [
            f"No effect outside the model is needed (probability {p:.2f}): what is left is no more than a real "
            f"specimen's usual difference from the model{tail}."
        ]
    if verdict["kind"] == "unknown":
        p = d["rest"]["probability"]
        doubt = [c["name"] for c in d["considered"]]
        tail = f"; {listed(doubt)} cannot be excluded" if doubt else ""
        return [
            f"The cause is unknown (probability {p:.2f}): the gap is real, but no effect of the catalogue explains a "
            f"part of it that holds on all tests{tail}."
        ]
    return [_sentence(c, d) for c in verdict["causes"]]


def _sentence(c: dict[str, Any], d: dict[str, Any]) -> str:
    """One cause: its number, its share of the gap, fitted and on tests left out, and what it cannot be told from."""
    effect = next(e for e in d["effects"] if e["name"] == c["name"])
    number = _number(effect["parameters"])
    text = f"{_capital(title(c['name']))}{number} (probability {c['probability']:.2f}) removes {_percent(c['share'])} "
    text += f"of the gap ({_percent(c['share_interval'][0])} to {_percent(c['share_interval'][1])})"
    if c["share_held_out"] is not None:
        text += f", {_percent(c['share_held_out'])} on tests left out of the fit"
    if c["cannot_tell_apart"]:
        text += f"; these tests cannot tell it from {listed(c['cannot_tell_apart'])}"
    return text + "."


def _number(parameters: dict[str, Any]) -> str:
    """The first parameter with its standard deviation."""
    if not parameters:
        return ""
    name, p = next(iter(parameters.items()))
    unit = "" if p["unit"] in ("-", "") else f" {p['unit']}"
    what = name.split("[")[0].rsplit("_", name.count("_") if len(name.split("_")) > 2 else 1)[0].replace("_", " ")
    return f" of {p['mean']:.3g} ± {p['sd']:.1g}{unit}" if unit else f" ({what} {p['mean']:.3g} ± {p['sd']:.1g})"


def _rest(d: dict[str, Any]) -> list[str]:
    rest, kind = d["rest"], d["verdict"]["kind"]
    if kind == "explained":
        return [f"What is left, {_percent(rest['share'])} of the gap, is no more than a law slightly off leaves."]
    if kind not in ("partly_explained", "unknown"):
        return []
    out = []
    if kind == "partly_explained":
        out.append(
            f"The cause of the rest, {_percent(rest['share'])} of the gap, is unknown "
            f"(probability {rest['probability']:.2f} that it has one)."
        )
    if rest["physics"]:
        out.append(f"It looks most like {rest['physics']}.")
    if rest["line_at_half_frequency"] > 20.0:
        out.append("The records hold a line at half the test frequency: every second cycle differs.")
    return out


def _remedies(d: dict[str, Any]) -> list[str]:
    return [f"{_capital(title(e['name']))}: {e['remedy'].rstrip('.')}." for e in d["effects"] if e.get("remedy")]


def _next(d: dict[str, Any]) -> str:
    following = d["next_test"]
    if following is None:
        return "No further loop test is needed to settle which of the catalogue's effects contribute."
    pair = listed(following["separates"])
    if following["bench"]:
        return f"No loop test would separate {pair} well; at the bench: {following['bench']}."
    return (
        f"To separate {pair}, run {following['frequency_hz']:g} Hz at {following['amplitude_mm']:g} mm for "
        f"{following['cycles']} cycles (expected odds {_odds(following['expected_log_odds'])})."
    )


def _odds(log_odds: float) -> str:
    return "over 1000 : 1" if log_odds > 6.9 else f"{2.718281828**log_odds:.0f} : 1"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if abs(share) < 0.095 else f"{100 * share:.0f} %"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def listed(names: Sequence[str]) -> str:
    """Names of effects in running text."""
    words = [title(n) for n in names]
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


def force(newton: float) -> str:
    """A force to three digits in kN, N or mN."""
    for scale, unit in ((1e3, "kN"), (1.0, "N"), (1e-3, "mN")):
        if newton >= scale:
            return f"{newton / scale:.3g} {unit}"
    return f"{newton / 1e-3:.2g} mN"
