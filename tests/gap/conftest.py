"""A specimen, campaigns and fits for the tests of the gap room."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.campaign import Campaign, Record
from bayes_iwan.inference.defaults import Scales
from bayes_iwan.physics import Model, Reference, paper, sine_motion

SCALES = Scales(length_mm=0.9, speed_m_s=0.113, force_N=4.0, slip_N=1.2, soft_N_mm=5.5, stiff_N_mm=15.0)
#: harmonics and phases of the campaigns below: enough for gaps of a few per cent, and quick
SMALL = {"n_phase": 48, "n_harmonics": 16}
#: slip forces of two gammas: a third adds nothing that these campaigns could show
TWO_GAMMAS = {"model": {"slip": "gamma2"}}


def numbers_of(model: Model, draws: int = 1, **others) -> dict:
    """Table 1 (with what the model reads of it), (draws,) each, and other numbers of (draws,) or one for all."""
    out = {n: np.repeat(v, draws) for n, v in paper.table_1(model.reference).items() if n in model.names}
    return out | {n: np.broadcast_to(np.asarray(v, float), (draws,)).copy() for n, v in others.items()}


def elastic(reference) -> tuple[Model, dict]:
    """A spring of 10 N/mm: parallel 4 N/mm and elements of 6 N/mm, none of which slips below 30 N."""
    model = Model(reference, slip="uniform", grip="constant", stiffness="constant")
    return model, {"kp_N_mm": np.array([4.0]), "force_zero_N": np.zeros(1), "k1_N_mm": np.array([6.0]),
                   "slip_mean_N": np.array([50.0]), "slip_width": np.array([0.4])}


def made_up(force, tests, cycles=12, rate=1280.0, noise_N=0.0, extra=None, seed=0, roles=None):
    """A campaign of sines: force(amplitude, frequency) gives one cycle (n,) of the specimen's force on phases from the
    upward crossing; extra(time, test) is added along the record. Frequencies divide the sampling rate."""
    records = []
    for i, (f, a) in enumerate(tests):
        per = round(rate / f)
        time = np.arange(cycles * per) / rate
        values = np.tile(force(a, f, per), cycles)
        values = values + noise_N * np.random.default_rng([seed, i]).standard_normal(time.size)
        if extra is not None:
            values = values + extra(time, i)
        records.append(Record(f"t{i}.csv", f, a, (roles or {}).get(i, "fit"), {}, time,
                              a * np.sin(2.0 * np.pi * f * time), values))
    return Campaign("made up", "", "", "", Path("made_up"), tuple(records))


def specimen_force(amplitude, frequency, samples):
    """One cycle of Table 1's force."""
    model = Model(SCALES.reference)
    return model.force(numbers_of(model), sine_motion(amplitude, frequency, samples))[0, 0]


#: tests by plan: frequency, amplitude, role
PLANS = {"grid": [(f, a, "fit") for f in (8.0, 20.0) for a in (0.4, 0.9)],
         "single": [(10.0, a, "fit") for a in (0.3, 0.5, 0.9)]}
PLANS["held out"] = [*PLANS["grid"], (13.0, 0.6, "held-out")]


@cache
def rig_records(effect: str | None, plan: str = "grid"):
    """Tests on the virtual rig, the effect at an eighth of the friction force."""
    from bayes_iwan.gap.rig import PlannedTest
    from bayes_iwan.gap.rig_planning import simulate_campaign

    tests = [PlannedTest(f, a, cycles=12, role=role) for f, a, role in PLANS[plan]]
    return simulate_campaign(tests, effect=effect, size=0.12, seed=3)


def campaign_of(virtual) -> Campaign:
    return Campaign("virtual rig", "", "", "", Path("virtual_rig"), virtual.records)


@cache
def diagnosed(effect: str | None, plan: str = "grid"):
    """Quick diagnosis of a rig campaign, once a session."""
    from bayes_iwan.gap.diagnosis import diagnose_loops

    campaign = campaign_of(rig_records(effect, plan))
    return diagnose_loops(campaign, campaign.loops(**SMALL), seed=1, quick=True, config=TWO_GAMMAS)


@pytest.fixture(scope="session")
def kit():
    return SimpleNamespace(scales=SCALES, small=SMALL, config=TWO_GAMMAS, numbers=numbers_of, elastic=elastic,
                           made_up=made_up, specimen_force=specimen_force, rig_records=rig_records,
                           campaign_of=campaign_of, diagnosed=diagnosed, reference=Reference(0.9, 0.113))
