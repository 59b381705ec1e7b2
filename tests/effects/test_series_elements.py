"""Effects in series against a solution of their own: stop elements in plain numpy, marched step by step from rest."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize

from bayes_iwan.effects import mounting
from bayes_iwan.models import Model, sine_motion
from bayes_iwan.models.motion import Y_FLOOR
from bayes_iwan.models.simulator import recorded_force

HZ, AMPLITUDE, SAMPLES, ELEMENTS, CYCLES = 12.0, 0.9, 1600, 800, 2
SPRING, SLIP, STIFF = 2.0, 1.2, 14.0


class Elements:
    """A parallel spring and stop elements with slip forces from 0 to 2·SLIP, under a normal force that follows u."""

    def __init__(self, slope, beta):
        self.slope, self.beta = slope, beta
        self.phi = 2.0 * SLIP * (np.arange(ELEMENTS) + 0.5) / ELEMENTS
        self.sliders, self.at = np.zeros(ELEMENTS), 0.0

    def alpha(self, d):
        y = np.maximum(AMPLITUDE - d, Y_FLOOR * AMPLITUDE)
        return 1.0 + self.slope * (y**self.beta - AMPLITUDE**self.beta) / self.beta

    def carried(self, d):
        most = self.alpha(d) * self.phi
        return np.clip(STIFF * (d - self.sliders), -most, most)

    def force(self, d):
        """What it would be at d, N; nothing moves."""
        return SPRING * d + self.carried(d).mean()

    def move(self, d):
        self.sliders, self.at = d - self.carried(d) / STIFF, d
        return self.force(d)


def in_series(elements, compliance, ratio, first):
    """A step for u = d + C·(F + (ratio − 1)·first·(1 − e^(−|F|/first))·sgn F)."""

    def step(u):
        def left(d):
            f = elements.force(d)
            return u - d - compliance * (f + (ratio - 1.0) * first * (1.0 - np.exp(-abs(f) / first)) * np.sign(f))

        return elements.move(optimize.brentq(left, -2.0 * AMPLITUDE, 2.0 * AMPLITUDE, xtol=1e-13))

    return step


def behind_a_play(elements, half):
    """A step for a specimen that is moved by the ends of a play and rests between them where its force is zero."""
    side = 0  # at which end of the play the specimen is: -1, 1, or 0 between them

    def step(u):
        nonlocal side
        d = u - side * half if side else elements.at
        if side and side * elements.force(d) < 0.0:  # the end would pull: the specimen stays where its force is zero
            side, d = 0, optimize.brentq(elements.force, elements.at, d, xtol=1e-14)
        if not side and abs(u - d) > half:
            side = 1 if u > d else -1
            d = u - side * half
        return elements.move(d)

    return step


@pytest.mark.parametrize(("slope", "beta"), [(0.0, 1.0), (-0.25, 0.7)], ids=["constant", "varying"])
@pytest.mark.parametrize(
    ("kind", "given", "believed"),
    [
        (mounting.FreePlay, {"play_mm": 0.09, "softness": 1e-6}, 1.0),
        (mounting.FreePlay, {"play_mm": 0.5, "softness": 1e-6}, 1.0),
        (mounting.RigCompliance, {"compliance_mm_N": 0.006, "soft_ratio": 3.0, "soft_N": 0.6}, 1.0),
        (mounting.RigCompliance, {"compliance_mm_N": 0.08, "soft_ratio": 1.0, "soft_N": 1.0}, 1.0),
        (mounting.RigCompliance, {"compliance_mm_N": 0.08, "soft_ratio": 1.0, "soft_N": 1.0}, 0.01),
    ],
    ids=["play of a tenth", "play of half the stroke", "stiff rig", "rig softer than the specimen",
         "specimen a hundred times as stiff as its loops' slopes say"],
)  # fmt: skip
def test_it_is_what_stop_elements_do_step_by_step(kind, given, believed, slope, beta, kit):
    effect = kind(replace(kit.scales, stiff_N_mm=believed * kit.scales.stiff_N_mm))
    model = Model(kit.reference, "uniform", "hunt_crossley_no_speed", "constant")
    ell = kit.reference.length_mm
    values = {"kp_N_mm": SPRING, "k1_N_mm": STIFF, "slip_mean_N": SLIP, "slip_width": 1.0, "beta": beta}
    values["normal_force_slope"] = slope * ell**beta
    values |= {f"{effect.name}.{n}": x for n, x in given.items()}
    assert {*model.names, *(p.name for p in effect.parameters)} == {*values}
    values = {n: np.array([x]) for n, x in values.items()}
    motion = sine_motion(frequency_hz=HZ, amplitude_mm=AMPLITUDE, samples=SAMPLES)
    force = recorded_force(model, (effect,), values, motion)[0, 0]

    elements = Elements(slope, beta)
    step = (
        in_series(elements, *given.values()) if "soft_N" in given else behind_a_play(elements, 0.5 * given["play_mm"])
    )
    marched = np.array([step(u) for u in np.tile(motion.displacement_mm[0, 0], CYCLES)])[-SAMPLES:]
    friction = model.friction_force(values, motion)[0, 0]
    assert np.sqrt(np.mean((force - marched) ** 2)) < 1e-6 * np.sqrt(np.mean(friction**2))
    without = recorded_force(model, (), values, motion)[0, 0]
    assert np.sqrt(np.mean((force - without) ** 2)) > 0.02 * np.sqrt(np.mean(friction**2))


@pytest.mark.parametrize("softness", [0.01, 0.3])
def test_the_ends_of_a_play_close_softly_about_the_place_where_the_force_crosses_zero(softness):
    """x − c = half + w·ln(1 + …): far from an end as hard as it is, at it w·ln 2 beyond it."""
    u, half, width = np.linspace(-1.0, 1.0, 401), 0.1, 0.1 * softness
    for column, c, velocity in ((0, 0.3, 1.0), (1, -0.45, -1.0)):
        crossing, out = np.full((1, 1, 2), np.nan), np.empty((1, 1, 401))
        crossing[0, 0, column] = c
        rising = np.full((1, 1, 401), velocity)
        mounting._through_play(u[None, None], rising, np.array([half]), np.array([softness]), crossing, out)
        ahead, behind = (np.logaddexp(0.0, (sign * (u - c) - half) / width) for sign in (1.0, -1.0))
        np.testing.assert_allclose(out[0, 0], c + width * (ahead - behind), atol=1e-14)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_force_that_keeps_its_sign_holds_the_specimen_at_one_end_of_the_play(sign, kit):
    """However small it is: a preloaded spring, moved by half the play less than the rig."""
    effect = mounting.FreePlay(kit.scales)
    motion = sine_motion(frequency_hz=HZ, amplitude_mm=AMPLITUDE, samples=64)

    asked = []

    def preloaded(at, some=None):
        asked.append(at)
        return sign * 0.05 + 0.01 * at.displacement_mm

    found = effect.around(preloaded, motion, effect.values_at(play_mm=0.2, softness=1e-6))
    np.testing.assert_allclose(found, sign * 0.05 + 0.01 * (motion.displacement_mm - sign * 0.1), rtol=1e-12)
    assert len(asked) == 2  # for the sign, and at the end: there is nothing to solve


def test_a_force_that_jumps_where_nothing_balances_it_is_no_number(kit):
    """F·sgn x behind a compliance C: for |u| < C·F no x + C·F·sgn x is u. Another draw keeps its own."""
    effect = mounting.RigCompliance(kit.scales)
    motion = sine_motion(frequency_hz=HZ, amplitude_mm=AMPLITUDE, samples=64)
    level = np.array([1.0, 0.0])

    def coulomb(at, some=slice(None)):
        x = np.broadcast_to(at.displacement_mm, (level[some].size, 1, 64))
        return level[some, None, None] * np.sign(x) + x

    given = effect.values_at(compliance_mm_N=0.3, soft_ratio=1.0, soft_N=1.0)
    found = effect.around(coulomb, motion, {n: np.repeat(x, 2) for n, x in given.items()})
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1], motion.displacement_mm[0] / 1.3, rtol=1e-8)


@pytest.mark.parametrize(("kind", "passes"), [(mounting.RigCompliance, 9), (mounting.FreePlay, 9)])
def test_a_loop_that_is_not_solved_leaves_the_others_their_force(kit, monkeypatch, kind, passes):
    """A small and a large loop of one draw, of which as many passes solve one."""
    effect, model = kind(kit.scales), Model(kit.reference)
    motion = sine_motion(frequency_hz=[HZ, HZ], amplitude_mm=[0.003, 0.9])
    given = {"compliance_mm_N": 0.05, "soft_ratio": 1.0, "soft_N": 1.0, "play_mm": 0.1, "softness": 1e-3}
    own = effect.values_at(**{p.name.split(".")[1]: given[p.name.split(".")[1]] for p in effect.parameters})
    asked = model, (effect,), kit.parameter_values(model) | own, motion
    whole = recorded_force(*asked)[0]
    monkeypatch.setattr(mounting, "MOST_PASSES", passes)
    found = recorded_force(*asked)[0]
    solved = np.isfinite(found).all(axis=1)
    assert solved.sum() == 1 and np.isnan(found[~solved]).all()
    np.testing.assert_allclose(found[solved], whole[solved], atol=1e-6)


def test_a_play_in_a_specimen_that_forgets_no_reversal_is_solved_from_near_its_end(kit):
    """Masing: from a reversal on the force is the same function of the way moved, so half the play shifts where it
    crosses zero by half the play, less what the smaller stroke changes."""
    effect, model = mounting.FreePlay(kit.scales), Model(kit.reference, "uniform", "constant", "constant")
    motion = sine_motion(frequency_hz=HZ, amplitude_mm=AMPLITUDE, samples=256)
    values = {"kp_N_mm": SPRING, "k1_N_mm": STIFF, "slip_mean_N": SLIP, "slip_width": 1.0}
    given = effect.values_at(play_mm=0.4, softness=1e-3)
    assert {*model.names, *given} == {*values, *given}
    calls = 0

    def specimen(at, some=None):
        nonlocal calls
        calls += 1
        return model.force({n: np.array([x]) for n, x in values.items()}, at)

    effect.around(specimen, motion, given)
    assert calls <= 8  # 11 from where the force of a specimen without play crosses zero


@pytest.mark.parametrize("kind", mounting.EFFECTS)
def test_it_is_solved_to_the_stated_tolerance_whatever_draws_stand_beside(kind, kit):
    """Each draw goes on until it is solved, alone or among others, and more passes change nothing."""
    effect, model = kind(kit.scales), Model(kit.reference)
    rng, motion = np.random.default_rng(2), sine_motion(frequency_hz=[8.0, 20.0], amplitude_mm=[AMPLITUDE, 0.4])
    z = 0.3 * rng.standard_normal((40, len(model.parameters(kit.scales))))
    sampled = {p.name: p.value(z[:, i]) for i, p in enumerate(model.parameters(kit.scales))}
    size = effect.first_guess() * np.exp(rng.standard_normal(40))
    values = model.parameter_values(sampled) | effect.values_at(**{effect.strength_name.split(".")[1]: 1.0})
    values = {n: np.broadcast_to(x, (40,)).copy() for n, x in values.items()} | {effect.strength_name: size}
    together = recorded_force(model, (effect,), values, motion)
    for d in (0, 17, 39):
        alone = recorded_force(model, (effect,), {n: x[d : d + 1] for n, x in values.items()}, motion)[0]
        assert np.array_equal(alone, together[d])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mounting, "TOLERANCE", 1e-13)
        patch.setattr(mounting, "MOST_PASSES", 200)
        exact = recorded_force(model, (effect,), values, motion)
    off = np.sqrt(np.mean((together - exact) ** 2, axis=-1) / np.mean(exact**2, axis=-1))
    assert off.max() < 1e-6
