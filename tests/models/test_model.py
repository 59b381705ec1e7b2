"""The whole line from motion to force: the paper's figures, its degeneracies and maps, and what callers rely on."""

from dataclasses import replace

import numba as nb
import numpy as np
import pytest

from bayes_iwan.models import Model, ModelError, record_motion, sine_motion
from bayes_iwan.models.kernels.pointwise import _expm1
from bayes_iwan.models.motion import Y_FLOOR
from bayes_iwan.models.normal_force import (
    ALPHA_FLOOR,
    LAWS,
    Reference,
    from_paper_hunt_crossley,
    paper_hunt_crossley,
)
from bayes_iwan.models.simulator import recorded_force
from bayes_iwan.models.stiffness import LAWS as STIFFNESS_LAWS
from bayes_iwan.models.stiffness import elasticity, from_paper_stiffness, paper_stiffness, ratio_of_elasticity
from bayes_iwan.threads import ALONE

AMPLITUDES, FREQUENCIES = np.repeat([0.3, 0.6, 1.0], 3), np.tile([10.0, 15.0, 20.0], 3)


def energy(force, motion):
    """∮ F du of each loop, N·mm."""
    u = motion.displacement_mm
    return np.sum(0.5 * (force + np.roll(force, -1, axis=-1)) * (np.roll(u, -1, axis=-1) - u), axis=-1)


def test_a_motion_has_one_number_a_loop_or_one_for_all():
    t = np.arange(200) / 1000.0
    for motion, loops in (
        (record_motion(t, np.sin(2 * np.pi * 10.0 * t)), 1),
        (sine_motion(frequency_hz=[8.0, 9.0, 10.0], amplitude_mm=1.0), 3),
    ):
        assert motion.loops == loops
        for name in ("frequency_hz", "amplitude_mm", "cycle", "test"):
            assert getattr(motion, name).shape == (loops,), name
        for name in ("step_s", "span_cycles"):
            assert getattr(motion, name).shape in ((1,), (loops,)), name
    assert motion.periodic and not record_motion(t, np.sin(60.0 * t)).periodic


# --- the paper


def test_table_1_gives_the_papers_figures(truth, reference):
    """k(1) = 14.45 N/mm; friction loops at A = 1 mm enclose 4.70, 5.00 and 5.31 N·mm at 10, 15 and 20 Hz."""
    parameter_values = truth.table_1(reference)
    model = Model(reference)
    assert parameter_values["k1_N_mm"][0] == pytest.approx(14.45, abs=0.005)
    assert model.slip_family.mean(parameter_values)[0] == pytest.approx(1.199, abs=5e-4)
    motion = sine_motion(frequency_hz=[10.0, 15.0, 20.0], amplitude_mm=1.0, samples=512)
    np.testing.assert_allclose(
        energy(model.friction_force(parameter_values, motion), motion)[0], [4.70, 5.00, 5.31], atol=0.005
    )


def test_alpha_of_table_1_needs_its_floor(truth, reference):
    """As printed, Eq. (11) falls to 1 − 1.79 = −0.79 at u = A; with y ≥ 0.01 A it stays near 0.95."""
    motion = sine_motion(frequency_hz=10.0, amplitude_mm=1.0)
    alpha = Model(reference).alpha(truth.table_1(reference), motion)[0, 0]
    u, speed = motion.displacement_mm[0, 0], np.abs(motion.velocity_m_s[0, 0])
    y = np.abs(1.0 - u) ** 0.0062
    printed = 1.79 * (y - 1.0) + 1.58 * 1.79 * y * speed + 1.0
    inside = 1.0 - u > Y_FLOOR
    np.testing.assert_allclose(alpha[inside], printed[inside], rtol=1e-12)
    assert printed.min() == pytest.approx(-0.79, abs=1e-9) and alpha.min() > 0.9


def test_eq_12_as_printed(truth, reference):
    parameter_values = truth.table_1(reference)
    alpha = np.linspace(0.05, 3.0, 50)[None, None]
    k = Model(reference).stiffness_law.k(parameter_values, alpha)
    np.testing.assert_allclose(k, 30.37 * (1.0 - np.exp(-19.62 * alpha / 30.37)), rtol=1e-13)


@pytest.mark.parametrize("slip", ["gamma3", "uniform", "gaussian", "power_law"])
def test_scale_degeneracy(slip, truth, reference):
    """c·min(ku, f) = min(cku, cf): weights times c do what slip forces and stiffness times c do. So Σg = 1."""
    parameter_values = (
        truth.table_1(reference, draws=2, spread=0.2)
        if slip == "gamma3"
        else (
            {n: v for n, v in truth.table_1(reference).items() if n[0] not in "teg" or n.startswith("normal_force")}
            | truth.family_cases[slip][0]
        )
    )
    model, motion = Model(reference, slip=slip), sine_motion(frequency_hz=FREQUENCIES, amplitude_mm=AMPLITUDES)
    forces = ("t1_N", "t2_N", "t3_N", "slip_mean_N", "slip_centre_N", "slip_sd_N", "slip_max_N", "k1_N_mm")
    scaled = {name: 3.7 * value if name in forces else value for name, value in parameter_values.items()}
    force = model.friction_force(parameter_values, motion)
    np.testing.assert_allclose(model.friction_force(scaled, motion), 3.7 * force, rtol=1e-10, atol=1e-10)
    if slip == "gamma3":
        factor = {"g": 3.7, "t": 1.0 / 3.7, "k1_N_mm": 1.0 / 3.7}
        heavier = {
            name: value * factor.get(name, factor.get(name[0], 1.0) if name[1].isdigit() else 1.0)
            for name, value in parameter_values.items()
        }
        np.testing.assert_allclose(model.friction_force(heavier, motion), force, rtol=1e-10, atol=1e-10)


def test_labels_do_not_matter(truth, reference):
    model, motion, parameter_values = (
        Model(reference),
        sine_motion(frequency_hz=FREQUENCIES, amplitude_mm=AMPLITUDES),
        truth.table_1(reference),
    )
    turned = dict(parameter_values)
    for a, b in ((1, 3), (2, 1), (3, 2)):
        turned |= {
            f"t{a}_N": parameter_values[f"t{b}_N"],
            f"eta{a}": parameter_values[f"eta{b}"],
            f"g{a}": parameter_values[f"g{b}"],
        }
    np.testing.assert_allclose(model.force(turned, motion), model.force(parameter_values, motion), atol=1e-12)


# --- maps to the paper's numbers


def test_paper_numbers_there_and_back():
    reference = Reference(length_mm=0.7, speed_m_s=0.11)
    kn, lam, beta = np.array([1.79, -0.3, 2.0]), np.array([1.58, 0.2, 5.0]), np.array([0.0062, 1.5, 0.4])
    back = paper_hunt_crossley(from_paper_hunt_crossley(kn, lam, beta, reference), reference)
    for name, value in (("kn_1_mm", kn), ("lambda_s_m", lam), ("beta", beta)):
        np.testing.assert_allclose(back[name], value, rtol=1e-13)
    flat = paper_hunt_crossley(
        {"normal_force_slope": np.zeros(1), "normal_force_rate": np.ones(1), "beta": np.ones(1)}, reference
    )
    assert np.isnan(flat["lambda_s_m"][0])  # λ = rate/slope is not defined there
    ki, ku = np.array([19.62, 3.0, 100.0]), np.array([30.37, 50.0, 20.0])
    back = paper_stiffness(from_paper_stiffness(ki, ku))
    np.testing.assert_allclose(back["ki_N_mm"], ki, rtol=1e-13)
    np.testing.assert_allclose(back["ku_N_mm"], ku, rtol=1e-13)


def test_elasticity_there_and_back():
    """d ln k / d ln α at α = 1, by difference and inverted."""
    bend = np.geomspace(1e-6, 40.0, 60)
    np.testing.assert_allclose(ratio_of_elasticity(elasticity(bend)), bend, rtol=1e-6)
    parameter_values = {"k1_N_mm": np.full(60, 3.0), "stiffness_ratio": bend}
    h = 1e-5
    up, down = (
        STIFFNESS_LAWS["saturating"].k(parameter_values, np.full((60, 1, 1), 1.0 + s * h))[:, 0, 0] for s in (1, -1)
    )
    np.testing.assert_allclose(np.log(up / down) / (2 * h), elasticity(bend), rtol=1e-5, atol=1e-9)


# --- laws of the normal force


def test_hunt_crossley_is_a_logarithm_as_beta_vanishes(reference):
    """k̃ₙ(y^β − A^β) → k̃ₙβ ln(y/A): only slope and rate are left, without cancellation, at β = 0 too."""
    motion = sine_motion(frequency_hz=FREQUENCIES, amplitude_mm=AMPLITUDES)
    a = motion.amplitude_mm[:, None]
    y = np.maximum(a - motion.displacement_mm[0], Y_FLOOR * a)
    limit = 1.0 + 0.1 * np.log(y / a) + 0.3 * np.abs(motion.velocity_m_s[0]) / reference.speed_m_s
    for beta, bound in ((1e-3, 1e-2), (1e-6, 1e-5), (1e-9, 1e-8), (0.0, 1e-11)):
        parameter_values = {
            "normal_force_slope": np.array([0.1]),
            "normal_force_rate": np.array([0.3]),
            "beta": np.array([beta]),
        }
        alpha = LAWS["hunt_crossley"].alpha(parameter_values, motion, reference, 1)[0]
        np.testing.assert_allclose(alpha, limit, atol=bound)
        without = LAWS["hunt_crossley_no_speed"].alpha(parameter_values, motion, reference, 1)[0]
        np.testing.assert_allclose(without, 1.0 + 0.1 * np.log(y / a), atol=bound)


def test_hunt_crossley_at_beta_1_and_2_is_a_polynomial(reference):
    """β = 1 is a straight line in u, β = 2 a parabola, where the floor on y is out of reach."""
    motion = sine_motion(frequency_hz=15.0, amplitude_mm=0.5)
    motion = motion.moved(0.9 * motion.displacement_mm, motion.velocity_m_s, motion.acceleration_m_s2)
    slope = np.array([0.2])
    straight = LAWS["hunt_crossley_no_speed"].alpha(
        {"normal_force_slope": slope, "beta": np.ones(1)}, motion, reference, 1
    )
    line = LAWS["polynomial1"].alpha({"a1": -slope}, motion, reference, 1)
    np.testing.assert_allclose(straight, line, rtol=1e-13)
    bent = LAWS["hunt_crossley_no_speed"].alpha(
        {"normal_force_slope": slope, "beta": np.full(1, 2.0)}, motion, reference, 1
    )
    parabola = LAWS["polynomial2"].alpha({"a1": -slope * 0.5, "a2": slope / 2.0}, motion, reference, 1)
    np.testing.assert_allclose(bent, parabola, rtol=1e-13)


def test_polynomials_nest_and_keep_their_floor(reference):
    motion = sine_motion(frequency_hz=FREQUENCIES, amplitude_mm=AMPLITUDES)
    rng = np.random.default_rng(0)
    parameter_values = {f"a{d}": rng.normal(size=4) * 0.4 for d in range(1, 7)}
    x = motion.displacement_mm / reference.length_mm
    direct = 1.0 + sum(parameter_values[f"a{d}"][:, None, None] * x**d for d in range(1, 7))
    np.testing.assert_allclose(
        LAWS["polynomial6"].alpha(parameter_values, motion, reference, 4), np.maximum(direct, ALPHA_FLOOR), rtol=1e-12
    )
    parameter_values |= {f"a{d}": np.zeros(4) for d in (4, 5, 6)}
    np.testing.assert_array_equal(
        LAWS["polynomial6"].alpha(parameter_values, motion, reference, 4),
        LAWS["polynomial3"].alpha(parameter_values, motion, reference, 4),
    )
    np.testing.assert_array_equal(LAWS["constant"].alpha({}, motion, reference, 4), np.ones((4, 9, 128)))
    assert np.all(LAWS["polynomial1"].alpha({"a1": np.full(1, 5.0)}, motion, reference, 1) >= ALPHA_FLOOR)


def test_vectorised_exponential():
    x = np.r_[np.linspace(-50.0, 50.0, 20001), np.geomspace(1e-300, 1.0, 2000), -np.geomspace(1e-300, 1.0, 2000)]
    np.testing.assert_allclose([_expm1(v) for v in x], np.expm1(x), rtol=2e-14)
    assert _expm1(-1e4) == pytest.approx(-1.0) and _expm1(0.0) == 0.0 and np.isnan(_expm1(np.nan))


# --- motion


def test_loop_is_the_last_cycle_of_a_record(truth, reference):
    """Every law of the normal force: the steady loop equals the third cycle of a record that starts from rest."""
    n = 128
    t = np.arange(3 * n + 1) / (n * 15.0)
    for normal_force in LAWS:
        model = Model(reference, normal_force=normal_force)
        parameter_values = truth.table_1(reference) | {f"a{d}": np.array([0.2 / d]) for d in range(1, 7)}
        loop = sine_motion(frequency_hz=15.0, amplitude_mm=0.8, samples=n)
        record = record_motion(t, 0.8 * np.sin(2 * np.pi * 15.0 * t), amplitude_mm=0.8, frequency_hz=15.0)
        exact = replace(record, velocity_m_s=np.tile(loop.velocity_m_s, 4)[..., : 3 * n + 1])
        force = model.force(parameter_values, loop)[0, 0]
        np.testing.assert_allclose(model.force(parameter_values, exact)[0, 0, 2 * n : 3 * n], force, atol=1e-10)
        # velocity by central differences is good to 0.04 % of its amplitude
        np.testing.assert_allclose(model.force(parameter_values, record)[0, 0, 2 * n : 3 * n], force, atol=2e-3)


def test_sine_motion_is_consistent():
    motion = sine_motion(frequency_hz=12.0, amplitude_mm=[0.3, 1.0], samples=64)
    assert motion.displacement_mm.shape == (1, 2, 64) and (motion.loops, motion.samples) == (2, 64)
    np.testing.assert_allclose(motion.frequency_hz, 12.0)
    t = np.arange(64) / (64 * 12.0)
    np.testing.assert_allclose(
        motion.velocity_m_s[0, 1, 1:-1], 1e-3 * np.gradient(motion.displacement_mm[0, 1], t)[1:-1], atol=2e-4
    )
    np.testing.assert_allclose(motion.acceleration_m_s2, -1e-3 * (2 * np.pi * 12.0) ** 2 * motion.displacement_mm)
    moved = motion.moved(
        *(
            np.repeat(x, 3, axis=0) * np.arange(1, 4)[:, None, None]
            for x in (motion.displacement_mm, motion.velocity_m_s, motion.acceleration_m_s2)
        )
    )
    part = moved.of_draws(slice(1, 2))
    np.testing.assert_array_equal(part.displacement_mm[0], 2 * motion.displacement_mm[0])
    assert motion.of_draws(slice(1, 2)) is motion


# --- batches


@pytest.fixture
def restored_threads():
    before = nb.get_num_threads()
    yield
    nb.set_num_threads(before)


@pytest.mark.usefixtures("restored_threads")
def test_draws_do_not_feel_their_batch(truth, reference):
    """Alone, among others, on one thread or two: bit for bit the same force."""
    model, motion = Model(reference), sine_motion(frequency_hz=FREQUENCIES, amplitude_mm=AMPLITUDES)
    parameter_values = truth.table_1(reference, draws=150, spread=0.3)
    assert 150 * motion.loops * motion.samples > 2 * ALONE
    nb.set_num_threads(1)
    together = model.force(parameter_values, motion)
    nb.set_num_threads(min(2, nb.config.NUMBA_NUM_THREADS))
    np.testing.assert_array_equal(model.force(parameter_values, motion), together)
    for d in (0, 77, 149):
        alone = model.force({name: value[d : d + 1] for name, value in parameter_values.items()}, motion)
        np.testing.assert_array_equal(alone[0], together[d])
    each = motion.moved(
        *(np.repeat(x, 150, axis=0) for x in (motion.displacement_mm, motion.velocity_m_s, motion.acceleration_m_s2))
    )
    np.testing.assert_array_equal(model.force(parameter_values, each), together)  # a motion for every draw


@pytest.mark.usefixtures("restored_threads")
def test_an_error_on_a_thread_is_raised(truth, reference):
    nb.set_num_threads(min(2, nb.config.NUMBA_NUM_THREADS))
    parameter_values = truth.table_1(reference, draws=150)
    del parameter_values["eta2"]
    with pytest.raises(KeyError, match="eta2"):
        Model(reference).force(parameter_values, sine_motion(frequency_hz=FREQUENCIES, amplitude_mm=AMPLITUDES))


@pytest.mark.parametrize("slip", ["gamma3", "uniform", "gaussian", "power_law"])
def test_broken_draws_give_nan_and_spoil_no_other(slip, truth, reference):
    model, motion = Model(reference, slip=slip), sine_motion(frequency_hz=FREQUENCIES, amplitude_mm=AMPLITUDES)
    parameter_values = truth.table_1(reference, draws=3)
    if slip != "gamma3":
        parameter_values |= {name: np.repeat(value, 3) for name, value in truth.family_cases[slip][0].items()}
    sound = model.force(parameter_values, motion)
    assert np.all(np.isfinite(sound))
    for name in model.names:
        for value in (np.nan, np.inf):
            broken = dict(parameter_values) | {name: parameter_values[name].copy()}
            broken[name][1] = value
            force = model.force(broken, motion)
            np.testing.assert_array_equal(force[[0, 2]], sound[[0, 2]])
            if np.isnan(value):
                assert np.all(np.isnan(force[1])), name


@pytest.mark.parametrize("value", [0.0, -3.0])
def test_no_stiffness_no_force(value, truth, reference):
    parameter_values = truth.table_1(reference) | {"k1_N_mm": np.array([value])}
    assert np.all(
        np.isnan(
            Model(reference).force(parameter_values, sine_motion(frequency_hz=FREQUENCIES, amplitude_mm=AMPLITUDES))
        )
    )


def test_parts_of_the_force_add_up(truth, reference):
    model, motion = Model(reference), sine_motion(frequency_hz=FREQUENCIES, amplitude_mm=AMPLITUDES)
    parameter_values = truth.table_1(reference, draws=4, spread=0.2) | {"force_zero_N": np.array([0.0, 1.0, -2.0, 0.3])}
    friction = model.friction_force(parameter_values, motion)
    spring = parameter_values["kp_N_mm"][:, None, None] * motion.displacement_mm
    np.testing.assert_allclose(model.force(parameter_values, motion), friction + spring, atol=1e-13)
    np.testing.assert_allclose(
        recorded_force(model, (), parameter_values, motion),
        friction + spring + parameter_values["force_zero_N"][:, None, None],
        atol=1e-13,
    )


def test_unknown_parts_are_named(reference):
    with pytest.raises(ModelError, match=r"model.slip = 'gamma4' is not known; did you mean 'gamma"):
        Model(reference, slip="gamma4")
    with pytest.raises(ModelError, match=r"model.normal_force = 'hunt' is not known"):
        Model(reference, normal_force="hunt")
    with pytest.raises(ModelError, match=r"model.stiffness = 'soft' is not known"):
        Model(reference, stiffness="soft")


@pytest.mark.parametrize("slip", ["gamma1", "gamma2", "gamma3", "uniform", "gaussian", "power_law"])
def test_names_are_what_the_force_reads(slip, truth, reference):
    for normal_force in LAWS:
        for stiffness in STIFFNESS_LAWS:
            model = Model(reference, slip=slip, normal_force=normal_force, stiffness=stiffness)
            every = (
                truth.table_1(reference) | truth.family_cases[slip][0] | {f"a{d}": np.array([0.1]) for d in range(1, 7)}
            )
            assert np.all(
                np.isfinite(
                    model.force({n: every[n] for n in model.names}, sine_motion(frequency_hz=10.0, amplitude_mm=0.5))
                )
            )
