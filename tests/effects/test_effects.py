"""Every effect: vanishes at its neutral value, and does what its physics says in closed form."""

from dataclasses import replace
from itertools import permutations
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.effects import catalogue
from bayes_iwan.effects.base import Effect, EffectError, moved_by
from bayes_iwan.effects.empirical_patterns import lag_behind
from bayes_iwan.effects.paper_stages import EFFECTS as PAPER
from bayes_iwan.effects.paper_stages import missing_terms
from bayes_iwan.models import Model, Reference, record_motion, sine_motion
from bayes_iwan.models.simulator import recorded_force

ISSUE = (
    "viscous_damping maxwell_branch moving_mass quadratic_stiffness cubic_stiffness end_stop stribeck_weakening "
    "rate_strengthening normal_force_lag friction_fade spring_softening direction_dependent_friction rig_compliance "
    "free_play channel_delay integration_highpass force_highpass force_lowpass force_drift "
    "mains_interference force_clipping"
).split()
EVERY = (*catalogue.BUILT_IN, *PAPER)
EVERY = (*EVERY, *catalogue.FORM)
ALSO_SHAPES = (*EVERY, *catalogue.UNLISTED)
F_HZ, A_MM = 20.0, 0.9
OMEGA = 2.0 * np.pi * F_HZ


def motion(samples=128, cycle=0.0):
    return replace(
        sine_motion(frequency_hz=[F_HZ, 8.0], amplitude_mm=[A_MM, 0.3], samples=samples), cycle=np.full(2, cycle)
    )


def of(name, kit):
    """The effect of that name for the kit's scales, with two tests."""
    return next(e for e in ALSO_SHAPES if e.name == name)(kit.scales, ("a.csv", "b.csv"))


#: act on records, not on loops
RECORDS = ("force_drift", "mains_interference")
#: have a time or a speed of their own, which is known in terms of the record's
OWN_CLOCK = ("SpringSoftening", "DirectionDependentNormalForce", "DirectionDependentSlip", "NormalForceFree")

#: extra parameters at which a law is the classical one, where that is not their prior's median
CLASSIC = {
    "viscous_damping.exponent": 1.0,
    "stribeck_weakening.tail": 0.0,
    "friction_fade.tail": 0.0,
    "friction_fade.recovery": 0.0,
    "end_stop.exponent": 1.0,
    "end_stop.loss_s_m": 0.0,
    "maxwell_branch.spread": 1.0,
    "moving_mass.period_s": 0.0,
    "free_play.softness": 1e-9,
    "force_clipping.softness": 1e-9,
}


def at_median(effect, draws=1):
    return {p.name: np.full(draws, float(p.value(np.zeros(1))[0])) for p in effect.parameters}


def with_strength(effect, value, draws=1, **shapes):
    """Numbers of an effect: its strength (all of a hum's parts), given extra parameters, the classical law's else."""
    own = at_median(effect, draws) | {n: np.full(draws, v) for n, v in CLASSIC.items() if n.startswith(effect.name)}
    for name in own:
        if name in effect.strength_names:
            own[name] = np.broadcast_to(np.asarray(value, float), (draws,)).copy()
    return own | {
        f"{effect.name}.{n}": np.broadcast_to(np.asarray(v, float), (draws,)).copy() for n, v in shapes.items()
    }


def harmonics(force):
    """c_h of Re Σ c_h exp(2πi h phase), phase 0 at the upward crossing."""
    c = np.fft.rfft(force, axis=-1) * 2.0 / force.shape[-1]
    c[..., 0] /= 2.0
    return c


def forces(effect, strength, at, model, parameter_values, **shapes):
    """Force with the effect and without, (loops, samples)."""
    with_it = parameter_values | with_strength(effect, strength, **shapes)
    return recorded_force(model, (effect,), with_it, at)[0], recorded_force(model, (), parameter_values, at)[0]


def change(name, kit, strength, at=None, model=None, parameter_values=None, **shapes):
    """The same of the effect of that name, by default on Table 1."""
    model = Model(kit.reference) if model is None else model
    parameter_values = kit.parameter_values(model) if parameter_values is None else parameter_values
    return forces(of(name, kit), strength, motion() if at is None else at, model, parameter_values, **shapes)


def work(force, at):
    """∮F du, N·mm, by the spectral derivative of u: exact for what these loops hold."""
    n = at.samples
    slope = np.fft.irfft(2j * np.pi * np.arange(n // 2 + 1) * np.fft.rfft(at.displacement_mm[0]), n=n)
    return np.mean(force * slope, axis=-1)


# ---- the catalogue


def test_names_are_those_agreed():
    assert sorted(catalogue.NAMES) == sorted(ISSUE)


@pytest.mark.parametrize("kind", EVERY, ids=lambda k: k.__name__)
def test_every_effect_says_what_it_is(kind, kit):
    effect = kind(kit.scales, ("a.csv",))
    assert "Hz" not in effect.bench, "tests may have been slower, or have no clock: advice goes by theirs"
    for text in (effect.physics, effect.reference, effect.signature, effect.bench):
        assert len(text) > 10
    assert effect.first_guess() > 0
    for p in effect.parameters:
        assert p.name.startswith(effect.name + ".") and p.unit and p.symbol and p.description
    known = {e.name for e in EVERY}
    assert set(effect.look_alikes) <= known - {effect.name}


@pytest.mark.parametrize(
    "kind",
    [e for e in catalogue.BUILT_IN if e.name not in (*RECORDS, "force_clipping")],
    ids=lambda k: k.__name__,
)
def test_a_first_guess_moves_the_force_by_some_per_cent_of_the_slip_force(kind, kit):
    """Those left out act on records."""
    effect, model, at = kind(kit.scales, ("a.csv", "b.csv")), Model(kit.reference), motion(cycle=100.0)
    moved = np.subtract(*forces(effect, effect.first_guess(), at, model, kit.parameter_values(model)))
    assert 0.02 < np.sqrt(np.mean(moved**2)) / kit.scales.slip_N < 0.2


@pytest.mark.parametrize("kind", [e for e in ALSO_SHAPES if e.name not in RECORDS], ids=lambda k: k.__name__)
def test_what_needs_a_clock_tells_a_fast_motion_from_a_slow_one(kind, kit):
    """What needs none is the same at any speed, but for laws whose own time or speed may be that of the record."""
    effect, fast = kind(kit.scales), motion(cycle=100.0)
    model = Model(kit.reference, normal_force="hunt_crossley_no_speed")
    slow = sine_motion(frequency_hz=fast.frequency_hz / 3.0, amplitude_mm=fast.amplitude_mm)
    moved = [
        np.subtract(*forces(effect, effect.first_guess(), at, model, kit.parameter_values(model)))
        for at in (fast, replace(slow, cycle=fast.cycle))
    ]
    assert np.allclose(*moved, rtol=1e-9) != (effect.needs_clock or kind.__name__ in OWN_CLOCK)


@pytest.mark.parametrize("kind", ALSO_SHAPES, ids=lambda k: k.__name__)
@pytest.mark.parametrize("strength", [0.0, 1e-13])
def test_neutral_value_gives_the_base_model(kind, strength, kit):
    effect = kind(kit.scales, ("a.csv", "b.csv"))
    model = Model(kit.reference)
    parameter_values = kit.parameter_values(model, 3) | with_strength(effect, strength * effect.first_guess(), 3)
    at = motion(80, cycle=17.0)
    plain = model.force(parameter_values, at)
    np.testing.assert_allclose(recorded_force(model, (effect,), parameter_values, at), plain, atol=2e-8, rtol=0)


@pytest.mark.parametrize("kind", ALSO_SHAPES, ids=lambda k: k.__name__)
def test_switched_off_it_gives_the_base_bit_for_bit(kind, kit):
    effect, model = kind(kit.scales, ("a.csv", "b.csv")), Model(kit.reference)
    off = {n: np.full(2, v) for n, v in effect.off.items()}
    assert set(off) == {p.name for p in effect.parameters} and all(off[n][0] == 0.0 for n in effect.strength_names)
    parameter_values, at = kit.parameter_values(model, 2), motion(80, cycle=17.0)
    np.testing.assert_array_equal(
        recorded_force(model, (effect,), parameter_values | off, at),
        recorded_force(model, (Idle(kit.scales),), parameter_values, at),
    )


class Idle(Effect):
    """An effect that does nothing at any stage."""

    name = "idle"
    strength = ("nothing", "n", "-", "nothing")

    def first_guess(self):
        return 1.0


@pytest.mark.parametrize("kind", EVERY, ids=lambda k: k.__name__)
def test_every_effect_says_its_law_and_bends_it_about_the_classical_one(kind, kit):
    effect = kind(kit.scales, ("a.csv",))
    assert "gap-notes" not in kind.reference
    if kind not in PAPER:
        assert len(kind.law) > 2 and kind.remedy.endswith(".")
    refined = set(effect.extra_parameters()) - {n.split(".", 1)[1] for n in effect.scanned}
    assert len(effect.scanned) <= 2  # each multiplies the starts of every refit
    classic = {f"{effect.name}.{n}" for n in refined} & set(CLASSIC)
    for p in effect.parameters:  # the classical law is no rarity under the prior
        if p.name in classic and not p.name.endswith(
            ("softness", "tail", "recovery", "loss_s_m", "spread", "period_s")
        ):
            assert abs(float(p.score(np.array([CLASSIC[p.name]]))[0])) < 1.0


def test_laws_of_one_effect_differ_and_share_its_name():
    for name, kinds in catalogue.variants().items():
        assert len({k.law for k in kinds}) == len(kinds), name
    assert len(catalogue.variants()["end_stop"]) == 2 and len(catalogue.variants()["force_drift"]) == 2


@pytest.mark.parametrize("kind", ALSO_SHAPES, ids=lambda k: k.__name__)
def test_draws_do_not_depend_on_their_batch(kind, kit):
    effect = kind(kit.scales, ("a.csv", "b.csv"))
    model = Model(kit.reference)
    sizes = effect.first_guess() * np.array([0.3, 1.0, 2.0, 4.0])
    parameter_values = kit.parameter_values(model, 4, kp_N_mm=[3.0, 4.0, 5.0, 6.0]) | with_strength(effect, sizes, 4)
    at = motion(48, cycle=5.0)
    together = recorded_force(model, (effect,), parameter_values, at)
    alone = [
        recorded_force(model, (effect,), {n: v[i : i + 1] for n, v in parameter_values.items()}, at)[0]
        for i in range(4)
    ]
    np.testing.assert_array_equal(together, np.array(alone))


def test_order_of_effects_is_that_of_the_signal(kit):
    three = [of(n, kit) for n in ("force_clipping", "viscous_damping", "channel_delay")]
    model, at = Model(kit.reference), motion()
    parameter_values = kit.parameter_values(model)
    for effect, size in zip(three, (0.3, 0.004, 2e-3)):
        parameter_values |= with_strength(effect, size)
    clipping, viscous, delay = three
    by_hand = model.force(parameter_values, at)
    for effect in (viscous, delay, clipping):
        by_hand = effect.force(by_hand, at, parameter_values)
    for some in permutations(three):
        together = recorded_force(model, catalogue.ordered(some), parameter_values, at)
        np.testing.assert_allclose(together, by_hand, atol=1e-12)


# ---- inside the specimen


def test_viscous_damping_dissipates_pi_c_omega_a_squared(kit):
    c = 0.003
    extended, base = change("viscous_damping", kit, c)
    expected = [np.pi * c * OMEGA * A_MM**2, np.pi * c * 2 * np.pi * 8.0 * 0.3**2]
    np.testing.assert_allclose(work(extended - base, motion()), expected, rtol=1e-9)


def test_moving_mass_does_no_work_and_pushes_by_m_omega_squared(kit):
    m = 0.02
    extended, base = change("moving_mass", kit, m)
    np.testing.assert_allclose(work(extended - base, motion()), 0.0, atol=1e-12)
    c = harmonics(extended - base)[0]
    assert c[1] == pytest.approx(-1j * -m * OMEGA**2 * A_MM * 1e-3, rel=1e-9)  # u = A sin, so u ~ −iA
    assert np.abs(np.delete(c, 1)).max() < 1e-12


@pytest.mark.parametrize("ratio", [0.1, 1.0, 10.0])
def test_maxwell_branch_has_its_knee_at_one_over_two_pi_tau(ratio, kit):
    k, tau = 0.7, ratio / OMEGA
    extended, base = change("maxwell_branch", kit, k, tau_s=tau)
    stiffness = harmonics(extended - base)[0, 1] / (-1j * A_MM)
    assert stiffness == pytest.approx(k * 1j * ratio / (1 + 1j * ratio), rel=1e-9)
    if ratio == 1.0:
        assert stiffness.imag == pytest.approx(0.5 * k)  # the largest loss


def test_quadratic_and_cubic_stiffness(kit):
    extended, base = change("quadratic_stiffness", kit, 0.4)
    c = harmonics(extended - base)[0]
    assert c[0].real == pytest.approx(0.5 * 0.4 * A_MM**2)
    assert c[2] == pytest.approx(-0.5 * 0.4 * A_MM**2)
    np.testing.assert_allclose(work(extended - base, motion()), 0.0, atol=1e-12)
    extended, base = change("cubic_stiffness", kit, -0.5)
    c = harmonics(extended - base)[0]
    assert c[1] == pytest.approx(-1j * 0.75 * -0.5 * A_MM**3)
    assert c[3] == pytest.approx(1j * 0.25 * -0.5 * A_MM**3)
    np.testing.assert_allclose(work(extended - base, motion()), 0.0, atol=1e-12)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_end_stop_acts_on_its_side_beyond_the_clearance_only(side, kit):
    extended, base = change("end_stop", kit, side * 20.0, clearance_mm=0.7)
    extra, u = (extended - base)[0], motion().displacement_mm[0, 0]
    np.testing.assert_allclose(extra, side * 20.0 * np.maximum(side * u - 0.7, 0.0), atol=1e-12)
    assert np.abs(extra).max() == pytest.approx(20.0 * 0.2)
    np.testing.assert_array_equal((extended - base)[1], 0.0)  # 0.3 mm never reaches it


# ---- on the friction: at full slip every element carries its slip force, E[φ] in all


def full_slip(kit):
    """Classical Iwan specimen moved so far that all elements slip in mid-stroke; mean slip force."""
    model = Model(kit.reference, normal_force="constant", stiffness="constant")
    parameter_values = kit.parameter_values(model, kp_N_mm=0.0, k1_N_mm=1000.0)
    mean = float(
        sum(parameter_values[f"g{i}"] * parameter_values[f"t{i}_N"] * parameter_values[f"eta{i}"] for i in (1, 2, 3))[0]
    )
    return model, parameter_values, mean


def mid_stroke(name, kit, strength, cycle=0.0, **shapes):
    """Force at the upward and the downward crossing of the middle of a large stroke, over the mean slip force."""
    model, parameter_values, mean = full_slip(kit)
    at = replace(
        sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=256), cycle=np.array([cycle]), span_cycles=np.zeros(1)
    )
    force, plain = change(name, kit, strength, at, model, parameter_values, **shapes)
    assert plain[0, 0] == pytest.approx(mean, rel=1e-6) and plain[0, 128] == pytest.approx(-mean, rel=1e-6)
    return force[0, 0] / mean, force[0, 128] / mean


SPEED = 1e-3 * OMEGA * A_MM


def test_stribeck_weakening_in_mid_stroke(kit):
    up, down = mid_stroke("stribeck_weakening", kit, 0.3, v_s_m_s=0.05, memory_s=0.0)
    expected = 1.0 - 0.3 * (1.0 - np.exp(-SPEED / 0.05))
    assert (up, down) == (pytest.approx(expected, rel=1e-6), pytest.approx(-expected, rel=1e-6))


def test_rate_strengthening_in_mid_stroke(kit):
    up, down = mid_stroke("rate_strengthening", kit, 0.1, v0_m_s=0.01, memory_s=0.0)
    expected = 1.0 + 0.1 * np.log1p(SPEED / 0.01)
    assert (up, down) == (pytest.approx(expected, rel=1e-6), pytest.approx(-expected, rel=1e-6))


@pytest.mark.parametrize("name", ["stribeck_weakening", "rate_strengthening"])
def test_friction_remembers_the_slip_speed_of_the_last_moment(name, kit):
    """Speed |cos| through a first-order lag: its harmonics 2, 4, … by their closed form."""
    effect, at, tau = of(name, kit), motion(512), 0.004
    speed = effect.speed_m_s(at, {f"{name}.memory_s": np.array([tau])})[0, 0]
    h = np.arange(1, 40)
    c = 4.0 / np.pi * (-1.0) ** (h + 1) / (4.0 * h**2 - 1.0) / (1.0 + 2j * h * OMEGA * tau)
    phase = np.arange(512)[:, None] * 2.0 * np.pi / 512
    expected = SPEED * (2.0 / np.pi + np.sum((c * np.exp(2j * h * phase)).real, axis=1))
    np.testing.assert_allclose(speed, expected, atol=2e-3 * SPEED)


@pytest.mark.parametrize("cycle", [0.0, 8.0, 400.0])
def test_friction_fade_at_cycle_n(cycle, kit):
    up, _ = mid_stroke("friction_fade", kit, 0.25, cycle, cycles=8.0)
    assert up == pytest.approx(1.0 - 0.25 * (1.0 - np.exp(-cycle / 8.0)), rel=1e-6)


def test_what_changes_from_cycle_to_cycle_needs_several_blocks_of_cycles(kit):
    """Levels of two or three cycles say nothing of it; a line of the mains needs a frequency instead."""
    one, several = (SimpleNamespace(blocks=n, mains_possible=(True, True)) for n in (1, 4))
    for kind in ALSO_SHAPES:
        effect = kind(kit.scales, ("a.csv", "b.csv"))
        assert effect.possible(several)
        assert effect.possible(one) == (not effect.evolving or "mains" in effect.name)


@pytest.mark.parametrize("name, n0", [("friction_fade", "cycles"), ("spring_softening", "tau_s")])
def test_what_fades_within_the_records_is_told_whatever_it_comes_to_in_the_end(name, n0, kit):
    """Two records, their blocks in any order: the mean over both of 1 − left at the last block / left at the first."""
    effect, hz, pace = of(name, kit), 10.0, 40.0
    one = sine_motion(frequency_hz=[hz] * 5, amplitude_mm=kit.scales.length_mm, samples=16)
    cycle = np.array([9.0, 1.0, 5.0, 2.0, 3.0])
    blocks = replace(one, cycle=cycle, test=np.array([0, 0, 0, 1, 1]), span_cycles=np.full(5, 1e-6))
    for drop in (0.3, 0.6):
        at = effect.off | {f"{name}.drop": drop, f"{name}.{n0}": pace if n0 == "cycles" else pace / hz}
        at |= {f"{name}.{n}": 0.0 for n in ("tail", "recovery", "by_cycles", "by_power", "by_amplitude", "by_stroke")}
        found, unit = effect.within({k: np.array([v]) for k, v in at.items()}, blocks)["lost_in_records"]
        left = 1.0 - drop * (1.0 - np.exp(-cycle / pace))
        assert unit == "-"
        assert found == pytest.approx([1.0 - 0.5 * (left[0] / left[1] + left[4] / left[3])], rel=1e-4)


def test_what_faded_before_the_first_block_was_over_may_be_regained(kit):
    """A fade of a cycle that recovers in twenty, told from the second cycle to the twentieth."""
    effect = of("friction_fade", kit)
    one = sine_motion(frequency_hz=[10.0, 10.0], amplitude_mm=kit.scales.length_mm, samples=16)
    blocks = replace(one, cycle=np.array([2.0, 20.0]), test=np.zeros(2, int), span_cycles=np.full(2, 1e-6))
    at = effect.values_at(drop=0.3, cycles=0.2, tail=0.0, recovery=0.01)
    told = effect.within(at, blocks)
    left = [1.0 - 0.3 * np.exp(-0.01 * n / 0.2) for n in (2.0, 20.0)]
    assert told["lost_in_records"][0] == pytest.approx([1.0 - left[1] / left[0]], rel=1e-3)
    assert told["lost_in_records"][0] < 0.0


def test_records_of_one_block_of_cycles_tell_no_loss_within_them(kit):
    """Three cycles a level, as in most quasi-static protocols, said "lost in records 0 ± 0" beside a fade of a half."""
    effect, length = of("friction_fade", kit), kit.scales.length_mm
    one = sine_motion(frequency_hz=[10.0] * 3, amplitude_mm=length, samples=16)
    at = effect.values_at(drop=0.3, cycles=4.0, tail=0.0, recovery=0.0)
    assert effect.within(at, replace(one, cycle=np.ones(3), test=np.arange(3))) == {}
    two = replace(one, cycle=np.array([1.0, 1.0, 5.0]), test=np.array([0, 1, 1]))
    alone = replace(sine_motion(frequency_hz=[10.0] * 2, amplitude_mm=length, samples=16), cycle=np.array([1.0, 5.0]))
    alone = replace(alone, test=np.zeros(2, int))
    (found, _), (expected, _) = (effect.within(at, x)["lost_in_records"] for x in (two, alone))
    assert found == pytest.approx(expected)


def test_direction_dependent_friction_makes_a_mean_force(kit):
    up, down = mid_stroke("direction_dependent_friction", kit, 0.2)
    assert (up, down) == (pytest.approx(1.2, rel=1e-6), pytest.approx(-0.8, rel=1e-6))
    assert 0.5 * (up + down) == pytest.approx(0.2, rel=1e-6)


def test_direction_dependent_friction_against_elements_with_asymmetric_bounds(kit):
    model = Model(kit.reference, slip="uniform", normal_force="constant", stiffness="constant")
    parameter_values = {
        "kp_N_mm": np.array([2.0]),
        "force_zero_N": np.zeros(1),
        "k1_N_mm": np.array([12.0]),
        "slip_mean_N": np.array([2.0]),
        "slip_width": np.array([0.6]),
    }
    at, a = sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=128), 0.35
    force, _ = change("direction_dependent_friction", kit, a, at, model, parameter_values)
    phi = 2.0 * (1.0 + 0.6 * (2.0 * (np.arange(4000) + 0.5) / 4000 - 1.0))  # elements of equal weight
    carried, before, u = np.zeros(4000), 0.0, at.displacement_mm[0, 0]
    for _ in range(2):
        expected = []
        for x in u:
            carried = np.clip(carried + 12.0 * (x - before), -phi * (1.0 - a), phi * (1.0 + a))
            before = x
            expected.append(2.0 * x + carried.mean())
    np.testing.assert_allclose(force[0], expected, atol=2e-4)


def test_normal_force_lag_filters_the_normal_force(kit):
    effect, at = of("normal_force_lag", kit), motion()
    tau = 0.4 / OMEGA
    alpha = 1.0 + 0.3 * at.displacement_mm / A_MM
    got = harmonics(effect.normal_force(alpha, at, with_strength(effect, tau))[0, 0])
    before = harmonics(alpha[0, 0])
    assert got[0] == pytest.approx(1.0)
    assert got[1] == pytest.approx(before[1] / (1 + 0.4j), rel=3e-4)  # straight between samples


# ---- in series


def test_rig_compliance_adds_to_the_elastic_specimens(kit):
    model, parameter_values = kit.elastic(kit.reference)
    compliance = 0.005
    force, plain = change("rig_compliance", kit, compliance, None, model, parameter_values)
    u = motion().displacement_mm[0]
    np.testing.assert_allclose(plain, 10.0 * u, atol=1e-9)
    np.testing.assert_allclose(force, u / (1.0 / 10.0 + compliance), atol=1e-5)


def test_free_play_rests_at_zero_force_over_its_width(kit):
    model, parameter_values = kit.elastic(kit.reference)
    force, _ = change("free_play", kit, 0.2, None, model, parameter_values)
    u = motion().displacement_mm[0]
    np.testing.assert_allclose(force, 10.0 * np.sign(u) * np.maximum(np.abs(u) - 0.1, 0.0), atol=1e-9)


def test_free_play_with_friction_is_flat_on_both_branches_at_every_amplitude(kit):
    at = sine_motion(frequency_hz=[F_HZ, F_HZ], amplitude_mm=[0.9, 0.5], samples=512)
    force, _ = change("free_play", kit, 0.15, at, Model(kit.reference, normal_force="constant", stiffness="constant"))
    u, v = at.displacement_mm[0], at.velocity_m_s[0]
    for loop in range(2):
        for rising in (True, False):
            rests = (np.abs(force[loop]) < 0.01) & ((v[loop] > 0) == rising)
            assert np.ptp(u[loop, rests]) == pytest.approx(0.15, abs=0.015)


# ---- measuring channels


@pytest.mark.parametrize("tau", [1.5e-3, -1.5e-3])
def test_channel_delay_turns_every_harmonic_by_h_omega_tau(tau, kit):
    delayed, plain = (harmonics(x[0]) for x in change("channel_delay", kit, tau))
    h = np.arange(20)
    np.testing.assert_allclose(delayed[:20], plain[:20] * np.exp(-1j * h * OMEGA * tau), atol=1e-12)


def test_force_lowpass_and_highpass_transfer_functions(kit):
    h = np.arange(1, 20)
    tau, corner = 8e-4, 0.9
    low, plain = (harmonics(x[0]) for x in change("force_lowpass", kit, tau))
    np.testing.assert_allclose(low[1:20], plain[1:20] / (1 + 1j * h * OMEGA * tau), atol=1e-12)
    assert low[0] == pytest.approx(plain[0])
    high, plain = (harmonics(x[0]) for x in change("force_highpass", kit, corner))
    s = 1j * h * F_HZ / corner
    np.testing.assert_allclose(high[1:20], plain[1:20] * s / (1 + s), atol=1e-12)
    assert abs(high[0]) < 1e-5


def test_integration_highpass_gives_back_the_true_motion(kit):
    effect, true = of("integration_highpass", kit), motion()
    corner = 1.2
    f = true.frequency_hz[:, None] * np.arange(65)
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = np.where(f > 0, f / (f - 1j * corner), 1.0)
    seen = true.moved(
        *(
            np.fft.irfft(np.fft.rfft(x) * gain, n=128)
            for x in (true.displacement_mm, true.velocity_m_s, true.acceleration_m_s2)
        )
    )
    back = effect.motion(seen, with_strength(effect, corner))
    for name in ("displacement_mm", "velocity_m_s", "acceleration_m_s2"):
        np.testing.assert_allclose(getattr(back, name), getattr(true, name), atol=1e-9)


def test_force_clipping_makes_flat_tops_at_one_force_in_every_test(kit):
    force, plain = change("force_clipping", kit, 1.0 / 2.5)
    np.testing.assert_allclose(force, np.clip(plain, -2.5, 2.5), rtol=1e-7)
    assert (np.abs(force[0] - 2.5) < 1e-6).sum() > 5
    told = of("force_clipping", kit).reported(with_strength(of("force_clipping", kit), 0.4))
    assert told["limit_N"] == (pytest.approx(2.5), "N")


# ---- shapes without a cause


def test_speed_squared_dissipates_eight_thirds_c_omega_squared_a_cubed(kit):
    at = motion()
    with_it, without = change("speed_squared", kit, 40.0, at)
    speed = 2e-3 * np.pi * at.frequency_hz * at.amplitude_mm  # m/s
    np.testing.assert_allclose(work(with_it - without, at), 8.0 / 3.0 * 40.0 * speed**2 * at.amplitude_mm, rtol=1e-4)


def test_break_away_lifts_friction_after_reversals_and_wears_off(kit):
    model, at = Model(kit.reference, normal_force="constant", stiffness="constant"), motion(256)
    with_it, without = change("break_away", kit, 0.4, at, model=model, slide_mm=0.15)
    u, up = at.displacement_mm[0, 0], at.velocity_m_s[0, 0] > 0
    added, friction = (with_it - without)[0], np.ptp(without[0] - kit.parameter_values(model)["kp_N_mm"][0] * u) / 2.0
    assert np.abs(added[up & (u > 0.5 * A_MM)]).max() < 2e-4 * friction  # 1.3 mm after the reversal
    assert added[up & (u > -0.7 * A_MM) & (u < -0.3 * A_MM)].max() > 0.01 * friction


def test_break_away_in_mid_stroke(kit):
    """All elements slip there, an amplitude after the reversal, and carry by so much more."""
    up, down = mid_stroke("break_away", kit, 0.4, slide_mm=0.5)
    expected = 1.0 + 0.4 * np.exp(-A_MM / 0.5)
    assert (up, down) == (pytest.approx(expected, rel=1e-6), pytest.approx(-expected, rel=1e-6))


def lag_in_closed_form(x, rising, path):
    """Of ℓ dz/ds = sgn(dx) − z where x runs from −X to X and back: 1 − (1 + tanh X/ℓ)·e^(−(X + x)/ℓ) on the way up."""
    reach = np.max(x, axis=-1, keepdims=True)
    run = np.where(rising, reach + x, reach - x)
    return np.where(rising, 1.0, -1.0) * (1.0 - (1.0 + np.tanh(reach / path)) * np.exp(-run / path))


@pytest.mark.parametrize("effect", [e for e in ALSO_SHAPES if e.name not in RECORDS], ids=lambda e: e.__name__)
def test_a_record_from_rest_ends_in_the_steady_loop_or_is_refused(kit, effect):
    """Nothing that is solved for a steady loop takes a record for one."""
    model, one = Model(kit.reference), effect(kit.scales, ("a.csv",))
    own = kit.parameter_values(model) | at_median(one)
    n, cycles = 256, 6
    t = np.arange(1, cycles * n + 1) / (F_HZ * n)
    record = record_motion(t, A_MM * np.sin(OMEGA * t), amplitude_mm=A_MM, frequency_hz=F_HZ)
    loop = np.roll(
        recorded_force(model, [one], own, sine_motion(frequency_hz=F_HZ, amplitude_mm=A_MM, samples=n))[0, 0], -1
    )
    try:
        found = recorded_force(model, [one], own, record)[0, 0, -n:]
    except EffectError as error:
        assert "steady loops only" in str(error)
    else:
        assert np.std(found - loop) < 2e-3 * np.std(loop)


@pytest.mark.parametrize("path", [0.05, 0.4, 30.0])
def test_what_lags_by_its_path_is_the_closed_form_at_any_speed(path):
    at = motion(2048)  # reversals fall on samples
    rising = np.roll(at.velocity_m_s[0], 1, axis=-1) + at.velocity_m_s[0] > 0
    z = lag_behind(at.displacement_mm, at, np.array([path, path]))
    for one in z:
        np.testing.assert_allclose(one, lag_in_closed_form(at.displacement_mm[0], rising, path), atol=1e-9)


def test_a_lagging_force_loses_work_of_the_whole_force(kit):
    at = motion(512)
    with_it, without = change("lagging_force", kit, 0.2, at, path_N=0.5)
    turns = np.sign(np.diff(without, append=without[:, :1], axis=-1))
    lag = without - with_it
    assert np.abs(lag).max() <= 0.2 and np.all(np.sum(lag * turns, axis=-1) > 0.0)  # behind the force, on the mean
    slow = replace(at, velocity_m_s=0.01 * at.velocity_m_s)
    model = Model(kit.reference, normal_force="constant", stiffness="constant")
    fast_, slow_ = (np.subtract(*change("lagging_force", kit, 0.2, x, model=model, path_N=0.5)) for x in (at, slow))
    np.testing.assert_allclose(fast_, slow_)


def test_a_lagging_reading_is_where_the_specimen_is(kit):
    at, model = motion(512), Model(kit.reference, normal_force="constant", stiffness="constant")
    true = kit.parameter_values(model)
    z = lag_behind(at.displacement_mm, at, np.array([0.1]))
    with_it, _ = change("lagging_reading", kit, 0.03, at, model=model, path_mm=0.1)
    np.testing.assert_allclose(with_it, model.force(true, moved_by(at, at.displacement_mm + 0.03 * z))[0])
    # what its spring stores, which is no friction, is turned into work by the reading
    spring = true | {"k1_N_mm": np.full(1, 1e-9)}
    with_it, without = change("lagging_reading", kit, 0.03, at, model=model, parameter_values=spring, path_mm=0.1)
    np.testing.assert_allclose(with_it - without, true["kp_N_mm"][0] * 0.03 * z[0], atol=1e-7)


# ---- what the paper adds to the classical Iwan model


def test_papers_terms_on_the_classical_model_are_the_papers_model(kit):
    at = motion()
    reference = replace(kit.reference)
    whole = Model(reference)
    true = kit.parameter_values(whole)
    bend = true["stiffness_ratio"]
    classical = Model(reference, normal_force="constant", stiffness="constant")
    terms = catalogue.ordered([e(kit.scales) for e in PAPER])
    parameter_values = {
        n: v for n, v in true.items() if n not in ("beta", "normal_force_slope", "normal_force_rate", "stiffness_ratio")
    } | {
        "varying_normal_force.slope": true["normal_force_slope"],
        "varying_normal_force.beta": true["beta"],
        "speed_dependent_normal_force.rate": true["normal_force_rate"],
        "speed_dependent_normal_force.beta": np.array([2.0]),
        "stiffness_of_normal_force.elasticity": bend / np.expm1(bend),
    }
    np.testing.assert_allclose(recorded_force(classical, terms, parameter_values, at), whole.force(true, at), atol=1e-9)


@pytest.mark.parametrize("elasticity", [1e-4, 0.03, 0.4, 0.99])
def test_elasticity_is_the_slope_of_ln_k_over_ln_alpha_however_small(elasticity, kit):
    effect, alpha = of("stiffness_of_normal_force", kit), np.exp([[[-1e-4, 0.0, 1e-4]]])
    k = effect.stiffness(5.0 * np.ones_like(alpha), alpha, motion(), with_strength(effect, elasticity))[0, 0]
    assert k[1] == pytest.approx(5.0)
    assert np.log(k[2] / k[0]) / 2e-4 == pytest.approx(elasticity, rel=1e-5)


def test_papers_terms_are_offered_only_where_the_base_lacks_them():
    def names(model):
        return [e.name for e in missing_terms(Model(Reference(1.0, 0.1), **model))]

    assert names({}) == [] and not {e.name for e in PAPER} & set(catalogue.variants())
    assert names({"normal_force": "hunt_crossley_no_speed"}) == ["speed_dependent_normal_force"]
    classical = {"normal_force": "constant", "stiffness": "constant"}
    assert names(classical) == [e.name for e in PAPER]
    assert {e.name for e in PAPER} < set(catalogue.variants((), Model(Reference(1.0, 0.1), **classical)))


def test_springs_that_soften_take_the_parallel_spring_with_them(kit):
    """Its part of the force falls by the share that is lost; a simulator without one keeps its force."""
    effect, at = of("spring_softening", kit), replace(motion(), cycle=np.array([30.0, 30.0]), span_cycles=np.zeros(2))
    own = effect.values_at(drop=0.3, tau_s=1.5, tail=0.0, by_cycles=0.0, by_power=0.0, by_amplitude=0.0)
    force = np.ones((1, 2, 128))
    lost = 0.3 * (1.0 - np.exp(-30.0 / (np.array([F_HZ, 8.0]) * 1.5)))
    got = effect.force(force, at, own | {"kp_N_mm": np.array([4.0])})
    np.testing.assert_allclose(got, 1.0 - 4.0 * lost[:, None] * at.displacement_mm, rtol=1e-6)
    np.testing.assert_array_equal(effect.force(force, at, own), force)
