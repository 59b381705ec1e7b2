"""Priors of all effects: they follow the specimen's scales as their units say, and change only when someone means it.

`priors.json` has median, ends and spread of every parameter for one specimen. A change of a prior changes every
diagnosis; where it is meant, write the file anew and say in the commit what it was measured on:

    python -m tests.effects.test_priors
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayes_iwan.effects import catalogue
from bayes_iwan.effects.paper_stages import EFFECTS as PAPER
from bayes_iwan.effects.specimen_forces import ViscousDamping
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.models import Model, sine_motion
from bayes_iwan.models.simulator import recorded_force

TABLE = Path(__file__).with_name("priors.json")
KINDS = tuple(dict.fromkeys((*catalogue.BUILT_IN, *PAPER, *catalogue.FORM, *catalogue.UNLISTED)))
SCALES = Scales(length_mm=0.9, speed_m_s=0.113, force_N=4.0, slip_N=1.2, soft_N_mm=5.5, stiff_N_mm=15.0)
#: powers of (force, length, time) in which units count
UNITS = {"N": (1, 0, 0), "mm": (0, 1, 0), "m": (0, 1, 0), "s": (0, 0, 1), "Hz": (0, 0, -1), "kg": (1, -1, 2)}
POWERS = {"": 1, "²": 2, "³": 3}


def powers_of(unit: str) -> np.ndarray:
    """(3,) powers of force, length and time of a unit such as N·s²/m²."""
    out = np.zeros(3)
    for sign, part in zip((1, -1), unit.split("/")):
        for factor in part.split("·"):
            if factor not in ("1", "-"):
                name = factor.rstrip("²³")
                out += sign * POWERS[factor[len(name) :]] * np.array(UNITS[name])
    return out


def effects(scales: Scales) -> list:
    return [kind(scales, ("a.csv", "b.csv")) for kind in KINDS]


def row(p, effect) -> dict:
    """What there is to know of a parameter's prior: median, values one sd below and above, ends; is it scanned?"""
    values = [float(p.value(np.array([z]))[0]) for z in (-1.0, 0.0, 1.0)]
    return {"values": values, "ends": [float(p.lower), float(p.upper)], "scanned": p.name in effect.scanned}


def facts(effect) -> dict:
    """Its kind, and the row of each of its parameters."""
    kind = {
        "signed": effect.signed, "order": effect.order, "sudden": effect.sudden, "flexible": effect.flexible,
        "evolving": effect.evolving, "stages": sorted(effect.stages), "law_error": effect.law_error,
    }  # fmt: skip
    return kind | {p.name: row(p, effect) for p in effect.parameters}


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.__name__)
def test_priors_are_those_that_were_measured(kind):
    kept, now = json.loads(TABLE.read_text(encoding="utf-8")), facts(kind(SCALES, ("a.csv", "b.csv")))
    assert kind.__name__ in kept, "a new effect: write the table anew"
    kept = kept[kind.__name__]
    assert sorted(kept) == sorted(now)
    for key, value in kept.items():
        if isinstance(value, dict):
            assert now[key]["values"] == pytest.approx(value["values"], rel=1e-9), key
            assert now[key]["ends"] == pytest.approx(value["ends"], rel=1e-9), key
            assert now[key]["scanned"] == value["scanned"], key
        else:
            assert now[key] == value, key


@pytest.mark.parametrize("force, length, time", [(3.0, 1.0, 1.0), (1.0, 5.0, 1.0), (1.0, 1.0, 7.0), (2.0, 0.3, 11.0)])
def test_priors_follow_the_specimen_as_their_units_say(force, length, time, kit):
    """A prior in newtons, millimetres and seconds that does not know the specimen would fit one size of it only."""
    wrong = []
    for here, there in zip(effects(SCALES), effects(kit.scaled(force, length, time))):
        for p, q in zip(here.parameters, there.parameters):
            factor = float(np.prod(np.array([force, length, time]) ** powers_of(p.unit)))
            for z in (-1.0, 0.0, 1.0):
                x, y = (float(r.value(np.array([z]))[0]) for r in (p, q))
                if not np.isclose(y, factor * x, rtol=1e-6, atol=1e-12):
                    wrong.append((p.name, p.unit, x, y / x if x else y, factor))
    assert not {w[0] for w in wrong} - ABSOLUTE, wrong


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.__name__)
def test_similar_specimens_have_similar_loops(kind, kit):
    """Dynamic similarity: a specimen that is 1,000 times as strong, 10,000 times as long and 100 times as fast has the
    same loop in its own units. Only the high-passed force knows one: the mean comes through below a millihertz."""
    loops = []
    for force, length, time in ((1.0, 1.0, 1.0), (1e3, 1e4, 1e-2)):
        scales = kit.scaled(force, length, time)
        effect, model = kind(scales, ("a.csv", "b.csv")), Model(scales.reference)
        values = model.parameter_values({p.name: p.value(np.array([0.3])) for p in model.parameters(scales)})
        values |= {p.name: p.value(np.array([0.7])) for p in effect.parameters}
        at = sine_motion(frequency_hz=[20.0 / time, 8.0 / time], amplitude_mm=[0.9 * length, 0.3 * length])
        loops.append(recorded_force(model, (effect,), values, replace(at, cycle=np.full(2, 5.0))) / force)
    np.testing.assert_allclose(loops[1], loops[0], atol=1e-5)


@pytest.mark.parametrize("power", [0.3, 1.0, 1.6])
def test_a_damper_may_have_any_power_that_dampers_are_built_with(power):
    """0.3 to 1.95 (Lee & Taylor, Struct. Des. Tall Build. 10 (2001) 311), below 2, where another mechanism begins."""
    (exponent,) = (p for p in ViscousDamping(SCALES, ()).parameters if p.name.endswith("exponent"))
    assert abs(exponent.score(np.array([power]))[0]) < 3.0


#: what does not follow all of a specimen's scales
ABSOLUTE = {"force_drift.rate_N_s"}  # a first guess per second, brought to the fitted specimen afterwards


if __name__ == "__main__":
    table = {type(effect).__name__: facts(effect) for effect in effects(SCALES)}
    TABLE.write_text(json.dumps(table, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
