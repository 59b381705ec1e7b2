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
    """The answer in three sentences: how large, which cause, what to do."""
    gap, verdict = d["gap"], d["verdict"]
    cause, p = verdict["cause"], verdict["probability"]
    size = (
        f"The model misses {_force(gap['before_rms_N'])} RMS ({_force(gap['before_interval_N'][0])} to "
        f"{_force(gap['before_interval_N'][1])}), {100 * gap['before_share']:.1f} % of the friction force, "
        f"beyond the records' own noise of {_force(gap['noise_rms_N'])}."
    )
    apart = [n for n in verdict["cannot_tell_apart"] if n != cause]
    if cause == "none":
        which = (
            f"No effect outside the model is needed (probability {p:.2f}): what is left is no more than a real "
            "specimen's usual difference from the model."
        )
    elif cause == "unknown":
        which = (
            f"The cause is unknown (probability {p:.2f}): the gap is real, but no effect of the catalogue closes "
            "it on all tests."
        )
        if d.get("looks_like"):
            which = f"{which[:-1]}; it looks most like {d['looks_like']['physics']}."
    if cause in ("none", "unknown"):
        if apart:
            which = f"{which[:-1]}; {_list(apart)} cannot be excluded."
    else:
        lead = next((e for e in d["effects"] if e["name"] == cause), None)
        which = f"The likeliest cause is {title(cause)} (probability {p:.2f})"
        if verdict["second_cause"]:
            which += f", together with {title(verdict['second_cause'])}"
        if apart:
            which += f"; these tests cannot tell it from {_list(apart)}"
        if lead:
            held = lead.get("shrink_held_out")
            added = "both" if verdict["second_cause"] else "it"
            which += f"; with {added} the gap shrinks by {100 * lead['shrink']:.0f} %"
            which += f" ({100 * held:.0f} % on tests left out of the fit)" if held is not None else ""
        which += "."
    following = d["next_test"]
    if following is None and apart:
        next_step = f"No loop test was found that would settle whether it is {_list(apart)}."
    elif following is None:
        next_step = "No further test is needed to settle this."
    elif following["bench"]:
        next_step = (
            f"No loop test would separate {_list(following['separates'])} well; at the bench: {following['bench']}."
        )
    else:
        next_step = (
            f"To separate {_list(following['separates'])}, run {following['frequency_hz']:g} Hz at "
            f"{following['amplitude_mm']:g} mm for {following['cycles']} cycles (expected odds "
            f"{_odds(following['expected_log_odds'])})."
        )
    return [size, which, next_step]


def beyond_sentence(terms: Sequence[str], beyond: dict[str, Any]) -> str:
    """What remains once terms that the base model lacked are in; beyond : that part of `diagnosis.json`."""
    gap, verdict = beyond["gap"], beyond["verdict"]
    cause = {"none": "needs no further cause", "unknown": "has a cause outside the catalogue"}.get(
        verdict["cause"], f"is likeliest due to {title(verdict['cause'])}"
    )
    return (
        f"With {_list(list(terms))} in the model it misses {_force(gap['before_rms_N'])}, "
        f"{100 * gap['before_share']:.1f} % of the friction force, which {cause} "
        f"(probability {verdict['probability']:.2f})."
    )


def _odds(log_odds: float) -> str:
    return "over 1000 : 1" if log_odds > 6.9 else f"{2.718281828**log_odds:.0f} : 1"


def _list(names: list[str]) -> str:
    words = [title(n) for n in names]
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


def _force(newton: float) -> str:
    for scale, unit in ((1e3, "kN"), (1.0, "N"), (1e-3, "mN")):
        if newton >= scale:
            return f"{newton / scale:.3g} {unit}"
    return f"{newton / 1e-3:.2g} mN"
