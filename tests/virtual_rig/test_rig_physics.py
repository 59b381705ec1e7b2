"""The rig against closed forms that were not made with it."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.virtual_rig import simulate
from bayes_iwan.virtual_rig.fault import Fault
from bayes_iwan.virtual_rig.faults import acting
from bayes_iwan.virtual_rig.kernel import march
from bayes_iwan.virtual_rig.simulate import Fidelity, PlannedTest, Setup
from bayes_iwan.virtual_rig.specimen import RigError, Specimen, paper_specimen

# no distortion, no errors, no yielding: what a closed form describes
IDEAL = Setup(
    shaker_compliance_mm_N=1e-7, fixture_compliance_mm_N=1e-7, second_harmonic=0, third_harmonic=0,
    frequency_error=0, amplitude_error=0, wander=0,
)  # fmt: skip
TEST = PlannedTest(10.0, 0.6, cycles=10, run_in=4)
OMEGA, A = 2 * np.pi * 10.0, 0.6


def uniform_specimen(mean_slip_N=1.0, n=400, **changes):
    """Constant normal force, slip forces uniform between 0 and twice their mean: everything has a closed form."""
    slip = 2 * mean_slip_N * (np.arange(n) + 0.5) / n
    parameter_values = {
        "parallel_N_mm": 5.0, "contact_N_mm": 14.0, "curve": 0.6, "curve_power": 1.0, "kn_1_mm": 0.0, "beta": 1.0,
        "lambda_s_m": 0.0, "tip": 0.01, "stiffness_share": np.full(n, 1 / n), "slip_share_N": slip / n,
        "family": "uniform",
    }  # fmt: skip
    return Specimen(**{**parameter_values, **changes})


def elastic_specimen(stiffness_N_mm):
    """No slip at all: a spring."""
    return uniform_specimen(mean_slip_N=1e6, n=4, parallel_N_mm=0.0, contact_N_mm=stiffness_N_mm)


def run(specimen, *faults, test=TEST, setup=IDEAL, **more):
    return simulate.VirtualRig(specimen, setup, faults).run(test, clean=True, **more)


def harmonic(r, h=1, signal=None):
    """Complex amplitude of the force (or `signal`) relative to the displacement's phase."""
    x = r.force_N if signal is None else signal
    n = len(r.time_s)
    whole = slice(0, n - n % 128)
    turn = 2j * np.pi * r.true_frequency_hz * r.time_s[whole]
    phase = np.angle(np.mean(r.displacement_mm[whole] * np.exp(-turn)))
    return 2 * np.mean(x[whole] * np.exp(-h * turn)) * np.exp(-1j * h * phase)


def test_virgin_curve_of_uniform_slip_forces():
    """F = k·u − k²u²/(4·mean) while the strongest still sticks, from rest."""
    k, mean = 14.0, 1.0
    u = np.linspace(0, 0.13, 2000)
    s = uniform_specimen(mean)
    q = simulate.kernel_values(replace(s, parallel_N_mm=0.0), IDEAL, acting(()), 10.0, A, 1e-4)
    force, _, _ = march(u, np.full(u.size, -1.0), 1e-4, s.stiffness_share, s.slip_share_N, *q)
    np.testing.assert_allclose(force, k * u - (k * u) ** 2 / (4 * mean), atol=2e-5)


def test_loop_area_of_uniform_slip_forces():
    """Masing's loop loses k²A³/(3·mean) a cycle; the work at the end and the work in the sliders agree with it."""
    k, mean, a = 14.0, 1.5, 0.18
    turn = np.linspace(0, 3, 3 * 4000 + 1)
    u = a * np.sin(2 * np.pi * turn)
    s = uniform_specimen(mean)
    q = simulate.kernel_values(s, IDEAL, acting(()), 10.0, a, 1e-4)
    force, _, lost = march(u, turn - 9, 1e-4, s.stiffness_share, s.slip_share_N, *q)
    last = slice(2 * 4000, None)
    expected = k**2 * a**3 / (3 * mean)
    assert np.trapezoid(force[last], u[last]) == pytest.approx(expected, rel=2e-3)
    assert lost[-1] - lost[2 * 4000] == pytest.approx(expected, rel=2e-3)


def test_energy_balance_from_rest_with_every_spring():
    """Work put in = work lost in slip + energy in the springs, at any instant (constant normal force)."""
    turn = np.linspace(0, 2.3, 12000)
    u = 0.3 * np.sin(2 * np.pi * turn) * turn
    s = uniform_specimen(0.8)
    effects = (Fault("quadratic_stiffness", {"k2_N_mm2": 2.0}), Fault("cubic_stiffness", {"k3_N_mm3": 3.0}))
    q = simulate.kernel_values(s, IDEAL, acting(effects), 10.0, 0.7, 1e-4)
    force, d, lost = march(u, turn - 9, 1e-4, s.stiffness_share, s.slip_share_N, *q)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(d))])
    springs = 0.5 * 5.0 * d**2 + 2.0 * d**3 / 3 + 3.0 * d**4 / 4
    in_elements = work - lost - springs
    # what is left sits in the elements' springs: never negative, at most Σ φ²/2k
    ceiling = np.sum(s.slip_share_N**2 / (2 * 14.0 * s.stiffness_share))
    assert in_elements.min() > -2e-3 * work[-1]
    assert in_elements.max() < 1.001 * ceiling
    at_rest = np.abs(d) < 1e-9
    assert in_elements[at_rest][0] == 0.0


def test_constant_normal_force_gives_a_symmetric_loop():
    r = run(uniform_specimen())
    assert abs(np.mean(r.force_N)) < 5e-3 and abs(harmonic(r, 2)) < 2e-3  # drive centred to 1 µm
    assert abs(harmonic(r, 3)) > 0.1


def test_viscous_damping_loses_pi_c_omega_a_squared():
    s, c = uniform_specimen(), 0.004
    change = harmonic(run(s, Fault("viscous_damping", {"c_N_s_mm": c}))) - harmonic(run(s))
    assert change.imag * np.pi * A == pytest.approx(np.pi * c * OMEGA * A**2, rel=0.01)
    assert abs(change.real) < 0.02 * change.imag


def test_quadratic_drag_first_harmonic():
    """c·v|v| has the first harmonic 8/(3π)·c·(ωA)²."""
    s, c = uniform_specimen(), 5e-5
    change = harmonic(run(s, Fault("quadratic_drag", {"c_N_s2_mm2": c}))) - harmonic(run(s))
    assert change.imag == pytest.approx(8 / (3 * np.pi) * c * (OMEGA * A) ** 2, rel=0.01)


def test_moving_mass_and_parallel_stiffnesses():
    s = uniform_specimen()
    base = harmonic(run(s))
    mass = harmonic(run(s, Fault("moving_mass", {"m_kg": 0.03}))) - base
    assert mass.real == pytest.approx(-0.03 * 1e-3 * OMEGA**2 * A, rel=0.01)
    cubic = harmonic(run(s, Fault("cubic_stiffness", {"k3_N_mm3": 2.0}))) - base
    assert cubic.real == pytest.approx(0.75 * 2.0 * A**3, rel=0.01)
    square = run(s, Fault("quadratic_stiffness", {"k2_N_mm2": 1.0}))
    assert abs(harmonic(square, 2)) == pytest.approx(0.5 * A**2, rel=0.02)
    assert np.mean(square.force_N) == pytest.approx(0.5 * A**2, rel=0.02)


def test_maxwell_branch_stores_and_loses():
    s, k, tau = uniform_specimen(), 0.8, 0.02
    change = harmonic(run(s, Fault("maxwell_branch", {"k_N_mm": k, "tau_s": tau}))) - harmonic(run(s))
    x = OMEGA * tau
    assert change.real == pytest.approx(k * A * x**2 / (1 + x**2), rel=0.01)
    assert change.imag == pytest.approx(k * A * x / (1 + x**2), rel=0.01)


def test_equal_compliance_halves_a_spring():
    spring = elastic_specimen(10.0)
    soft = run(spring, Fault("rig_compliance", {"compliance_mm_N": 0.1}))
    assert harmonic(soft).real == pytest.approx(0.5 * harmonic(run(spring)).real, rel=1e-3)


def test_compliance_against_a_graphical_solution():
    """With a spring in series the loop is the sheared one: F(u) = F₀(u − C·F), here on the virgin curve."""
    k, mean, c = 14.0, 1.0, 0.03
    u = np.linspace(0, 0.15, 2000)
    s = uniform_specimen(mean, parallel_N_mm=0.0)
    q = simulate.kernel_values(s, IDEAL, acting((Fault("rig_compliance", {"compliance_mm_N": c}),)), 10.0, A, 1e-4)
    force, d, _ = march(u, np.full(u.size, -1.0), 1e-4, s.stiffness_share, s.slip_share_N, *q)
    np.testing.assert_allclose(u - d, c * force, atol=1e-6)
    np.testing.assert_allclose(force, k * d - (k * d) ** 2 / (4 * mean), atol=3e-5)


def test_free_play_carries_no_force_across_its_width():
    play, s = 0.08, uniform_specimen()
    turn = np.linspace(0, 2, 2 * 4000 + 1)
    u = A * np.sin(2 * np.pi * turn)
    q = simulate.kernel_values(s, Setup(), acting((Fault("free_play", {"play_mm": play}),)), 10.0, A, 1 / 40000)
    force, d, _ = march(u, turn - 9, 1 / 40000, s.stiffness_share, s.slip_share_N, *q)
    down = (turn > 1.25) & (turn < 1.75)  # from one turning point to the other
    resting = down & (np.abs(force) < 1e-12)
    assert np.ptp(u[resting]) == pytest.approx(play, rel=0.08)  # it swings a little
    # the specimen's end stays where it was let go, but for a little settling
    assert np.ptp(d[resting]) < 0.1 * play
    carrying = down & ~resting
    assert np.all(np.abs(np.abs(u - d)[carrying] - 0.5 * play) < 2.1e-3 * np.abs(force).max())


def test_end_stop_acts_beyond_its_gap_only():
    s = uniform_specimen()
    sound, stopped = run(s), run(s, Fault("end_stop", {"clearance_mm": 0.45, "k_N_mm": 6.0}))
    change = stopped.force_N - sound.force_N
    assert np.abs(change[sound.displacement_mm < 0.40]).max() < 0.02
    assert change.max() == pytest.approx(6.0 * (A - 0.45), rel=0.05)


def test_friction_fades_with_the_cycles():
    s = uniform_specimen(0.5)
    drop, cycles = 0.4, 3.0
    long = PlannedTest(10.0, A, cycles=25, run_in=4)
    sound = run(s, test=long)
    faded = run(s, Fault("friction_fade", {"drop": drop, "cycles": cycles}), test=long)
    for first, mean_cycle in ((0, 0.5), (3, 3.5), (20, 20.5)):
        part = (sound.time_s * 10 >= first) & (sound.time_s * 10 < first + 1)
        areas = [np.trapezoid(r.force_N[part], r.displacement_mm[part]) for r in (faded, sound)]
        expected = 1 - drop * (1 - np.exp(-mean_cycle / cycles))
        # a lower slip force slips earlier: the area falls a little less than the force
        assert areas[0] / areas[1] == pytest.approx(expected, abs=0.05)


def test_friction_that_its_own_heat_lowers():
    """Less friction heats less: of a drop c·P without that, c·P/(1 + c·P) is left, reached (1 + c·P) times sooner."""
    s = uniform_specimen(0.5)
    long, tau = PlannedTest(10.0, A, cycles=25, run_in=3), 0.8
    sound = run(s, test=long)
    times = sound.time_s * 10

    def area(r, first):
        part = (times >= first) & (times < first + 1)
        return np.trapezoid(r.force_N[part], r.displacement_mm[part])

    cold_mW = area(sound, 5) * 10
    heated = run(s, Fault("friction_fade", {"drop": 0.4, "reference_mW": cold_mW, "tau_s": tau}, "heat"), test=long)
    for first in (3, 8, 22):
        expected = 1 - 0.4 / 1.4 * (1 - np.exp(-1.4 * (first + 3.5) / 10 / tau))  # it heats while running in, too
        # a lower slip force slips earlier, and the run-in begins softly: a little less is lost
        assert area(heated, first) / area(sound, first) == pytest.approx(expected, abs=0.04)


def test_slip_speed_laws_at_speeds_far_above_and_below_theirs():
    """All sliders slip at about the end's speed when their stiffness is high: friction × the law."""
    stiff = uniform_specimen(0.5, contact_N_mm=200.0, n=60)

    def middle(r):  # half the height of the loop at the middle, where the speed is ωA
        near = np.abs(r.displacement_mm) < 0.05
        rising = np.gradient(r.displacement_mm) > 0
        k = stiff.parallel_N_mm
        friction = r.force_N - k * r.displacement_mm
        return 0.5 * (friction[near & rising].mean() - friction[near & ~rising].mean())

    sound = middle(run(stiff))
    weak = middle(run(stiff, Fault("stribeck_weakening", {"drop": 0.3, "v_s_m_s": 0.002})))
    assert weak / sound == pytest.approx(0.7, abs=0.02)
    unreached = middle(run(stiff, Fault("stribeck_weakening", {"drop": 0.3, "v_s_m_s": 10.0})))
    assert unreached / sound == pytest.approx(1.0, abs=0.005)
    c, v0 = 0.1, 0.002
    strong = middle(run(stiff, Fault("rate_strengthening", {"c": c, "v0_m_s": v0})))
    assert strong / sound == pytest.approx(1 + c * np.log1p(OMEGA * A * 1e-3 / v0), abs=0.02)


def test_direction_dependent_friction_lifts_the_loop():
    s = uniform_specimen(0.3)
    lifted = run(s, Fault("direction_dependent_friction", {"asymmetry": 0.2}))
    change = np.mean(lifted.force_N) - np.mean(run(s).force_N)
    assert 0.8 * 0.2 * 0.3 < change < 0.2 * 0.3


def test_normal_force_follows_late():
    """A lag of τ turns the normal force's once-a-cycle part by arctan(ωτ) and shrinks it."""
    # nearly rigid sliders: friction = α·slip force·direction, so α can be read off the loop
    s = uniform_specimen(0.5, contact_N_mm=400.0, n=40, parallel_N_mm=0.0, kn_1_mm=0.3, beta=1.0)

    def alpha_phase(r):
        direction = np.sign(np.gradient(r.displacement_mm))
        return harmonic(r, 1, signal=np.abs(r.force_N) * (direction != 0))

    tau = 0.006
    late, prompt = alpha_phase(run(s, Fault("normal_force_lag", {"tau_s": tau}))), alpha_phase(run(s))
    assert np.angle(late / prompt) == pytest.approx(-np.arctan(OMEGA * tau), abs=0.06)
    assert abs(late / prompt) == pytest.approx(1 / np.hypot(1, OMEGA * tau), abs=0.06)


def alpha_along(*faults, cycles=24):
    """α along a record, by cycle and phase: nearly rigid sliders show it as friction over their slip force. An odd
    wave of the speed comes with it, so it is read where the force has settled after a reversal."""
    s = uniform_specimen(0.5, contact_N_mm=4000.0, n=40, parallel_N_mm=0.0, kn_1_mm=0.5, beta=1.0)
    r = run(s, *faults, test=PlannedTest(10.0, A, cycles=cycles, run_in=4))
    return np.abs(r.force_N)[: 128 * cycles].reshape(cycles, 128) / 0.5


def test_a_normal_force_that_lets_go_late_and_not_as_an_exponential():
    tau = 0.01

    def law(ratio, quick):
        return Fault("normal_force_lag", {"tau_s": tau, "ratio": ratio, "quick": quick}, "slow_release")

    first_order = alpha_along(Fault("normal_force_lag", {"tau_s": tau}))[-1]
    np.testing.assert_allclose(alpha_along(law(1.0, 0.0))[-1], first_order, atol=1e-9)
    late, quicker = alpha_along(law(4.0, 0.0))[-1], alpha_along(law(4.0, 8.0))[-1]
    # what lets go later stays higher; the farther it has to fall the quicker, so less high
    assert first_order.mean() + 0.01 < quicker.mean() < late.mean() - 0.005


def test_a_normal_force_with_two_slow_parts_creeps_with_both_times():
    slow, slower, share = 0.15, 0.9, 0.4
    given = {"tau_s": 0.01, "slow_share": share, "slow_ratio": slow / 0.01, "slower_ratio": slower / slow}
    level = alpha_along(Fault("normal_force_lag", given, "with_transient"), cycles=40).mean(axis=1)
    steady = alpha_along(Fault("normal_force_lag", {"tau_s": 0.01}), cycles=40).mean(axis=1)
    time = (np.arange(40) + 0.5) / 10.0
    parts = np.stack([np.exp(-time / slow), np.exp(-time / slower), np.ones(40)], axis=1)
    weight, *_ = np.linalg.lstsq(parts, level, rcond=None)
    assert np.abs(parts @ weight - level).max() < 0.02 * np.ptp(level)
    one = parts[:, [0, 2]]  # not with one of them
    assert np.abs(one @ np.linalg.lstsq(one, level, rcond=None)[0] - level).max() > 0.1 * np.ptp(level)
    assert np.ptp(level) > 5 * np.ptp(steady[1:])


def test_swinging_base_against_its_transfer_function():
    """A spring k on a base of mobility c: F = k·u / (1 + k·H), H the base's receptance."""
    k, c, f0, zeta = 8.0, 0.02, 25.0, 0.04
    spring = elastic_specimen(k)
    parameter_values = {"mobility_mm_N": c, "resonance_hz": f0, "damping_ratio": zeta}
    ratio = 10.0 / f0
    receptance = c / (1 - ratio**2 + 2j * zeta * ratio)
    long = PlannedTest(10.0, A, cycles=20, run_in=60)  # let the base's own swing die out
    found = harmonic(run(spring, Fault("base_resonance", parameter_values), test=long))
    assert found == pytest.approx(k * A / (1 + k * receptance), rel=0.01)


def test_rocking_makes_a_subharmonic():
    s = uniform_specimen(0.4)
    r, sound = run(s, Fault("rocking", {"share": 0.4})), run(s)
    assert abs(harmonic(r, 0.5)) > 20 * abs(harmonic(sound, 0.5))


def test_steps_and_lumped_sliders_hardly_matter():
    s = paper_specimen(240, seed=3)
    test = PlannedTest(15.0, 0.8, cycles=4, run_in=4)
    fine = run(s, test=test, setup=Setup(), fidelity=Fidelity(steps=6000))
    friction = np.sqrt(np.mean((fine.force_N - s.parallel_N_mm * fine.displacement_mm) ** 2))
    for fidelity, allowed in ((simulate.FULL, 1e-3), (simulate.COARSE, 8e-3)):
        r = run(s, test=test, setup=Setup(), fidelity=fidelity)
        assert np.sqrt(np.mean((r.force_N - fine.force_N) ** 2)) < allowed * friction


def test_two_faults_act_together_or_are_refused():
    """Forces add, factors multiply, filters follow one another; two values for one place are no rig at all."""
    dashpot, drag = Fault("viscous_damping", {"c_N_s_mm": 0.01}), Fault("quadratic_drag", {"c_N_s2_mm2": 1e-4})
    speed = np.array([-20.0, 5.0])
    np.testing.assert_allclose(acting((dashpot, drag)).speed_force(speed), 0.01 * speed + 1e-4 * speed * np.abs(speed))
    fading = [Fault("friction_fade", {"drop": d, "cycles": 8.0}) for d in (0.3, 0.2)]
    expected = (1.0 - 0.3 * (1.0 - np.exp(-0.5))) * (1.0 - 0.2 * (1.0 - np.exp(-0.5)))
    assert float(acting(fading).fade_factor(np.array(4.0))) == pytest.approx(expected)
    late = [Fault("channel_delay", {"delay_s": t}, "all_pass") for t in (1e-3, 2e-3)]
    chain = acting((*late, Fault("force_drift", {"rate_N_s": 0.1}), Fault("moving_mass", {"m_kg": 0.1}))).chain
    assert [x[1][0] for x in chain.force_filters] == [5e-4, 1e-3] and len(chain.additions) == 1
    assert chain.moving_mass_kg == 0.1 and acting(late).only_measured and not acting((dashpot, *late)).only_measured
    both = acting((Fault("end_stop", {"k_N_mm": 3.0, "clearance_mm": 0.5}), Fault("rocking", {"share": 0.2}))).motion
    assert (both.stop_k, both.stop_gap, both.rocking) == (3.0, 0.5, 0.2)
    for twice in (Fault("moving_mass", {"m_kg": 0.1}), Fault("end_stop", {"k_N_mm": 3.0, "clearance_mm": 0.5})):
        with pytest.raises(RigError, match=f"{twice.name} and {twice.name} cannot act together: both set"):
            acting((twice, twice))


def test_unknown_effect_and_missing_number_are_refused():
    with pytest.raises(RigError, match="no fault 'friction'"):
        run(uniform_specimen(), Fault("friction"))
    with pytest.raises(RigError, match="tau_s"):
        run(uniform_specimen(), Fault("normal_force_lag", {"tau": 1.0}))
    with pytest.raises(RigError, match="beyond the rig"):
        PlannedTest(10.0, 500.0)


def test_the_end_does_not_jump_after_reversals():
    """Where the stiffness follows the speed, the stuck elements' force drives the end on just after a reversal. On a
    spring without a loss it would jump, by as much as the step allows; with one the motion hardly depends on the step.
    """
    s = replace(paper_specimen(60), kn_1_mm=1.5, lambda_s_m=2.4, contact_N_mm=14.0)
    test = PlannedTest(21.0, 0.6, cycles=6, run_in=4)
    apart = {}
    for loss in (0.0, 0.1):
        setup = Setup(shaker_compliance_mm_N=4e-3, shaker_loss=loss)
        coarse, fine = (
            simulate.VirtualRig(s, setup).run(test, fidelity=Fidelity(steps, 60), clean=True) for steps in (1500, 12000)
        )
        stiffness = s.contact_N_mm + s.parallel_N_mm
        change = coarse.force_N - fine.force_N - stiffness * (coarse.displacement_mm - fine.displacement_mm)
        apart[loss] = np.sqrt(np.mean(change**2)) / np.ptp(fine.force_N)
    assert apart[0.1] < 2e-4 and apart[0.0] > 10 * apart[0.1]


def test_the_shaker_gives_way_late():
    """A spring on the shaker: its stretch lags the force by arctan η."""
    loss, stiffness = 0.2, 20.0
    setup = replace(IDEAL, shaker_compliance_mm_N=1e-2, shaker_loss=loss)
    body, _ = simulate.kernel_values(elastic_specimen(stiffness), setup, acting(()), 10.0, A, 1e-5)
    time = np.arange(0.0, 1.0, 1e-5)
    turn = OMEGA * time
    stretch = simulate.shaker_stretch(np.sin(turn), body)[time > 0.5]
    late = 1e-2 * np.sin(turn[time > 0.5] - np.arctan(loss)) / np.hypot(1.0, loss)
    np.testing.assert_allclose(stretch, late, atol=2e-6)
