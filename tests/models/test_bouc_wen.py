"""Bouc–Wen and its generalisation against scipy's integrator, and the loops they must and must not have."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayes_iwan.models import Scales, record_motion, sine_motion
from bayes_iwan.models.bouc_wen import OTHER_MODELS, BoucWen, GeneralizedBoucWen
from bayes_iwan.models.simulator import recorded_force

CASES = {
    "n = 0.2": ("bouc_wen", {"bw_k_N_mm": 14.0, "bw_force_N": 1.2, "bw_n": 0.2, "bw_share": 0.7}),
    "n = 1": ("bouc_wen", {"bw_k_N_mm": 14.0, "bw_force_N": 1.2, "bw_n": 1.0, "bw_share": 0.7}),
    "n = 2": ("bouc_wen", {"bw_k_N_mm": 14.0, "bw_force_N": 1.2, "bw_n": 2.0, "bw_share": 0.5}),
    "n = 8, stiff": ("bouc_wen", {"bw_k_N_mm": 80.0, "bw_force_N": 0.8, "bw_n": 8.0, "bw_share": 0.9}),
    "asymmetric": (
        "generalized_bouc_wen",
        {
            "bw_k_N_mm": 14.0,
            "bw_force_N": 1.2,
            "bw_n": 1.7,
            "bw_b2": -0.4,
            "bw_b3": 0.3,
            "bw_b4": 0.2,
            "bw_b5": 0.1,
            "bw_b6": -0.1,
        },
    ),
}


def parameter_values_of(case, truth, **more):
    family, parameter_values = CASES[case]
    return OTHER_MODELS[family], truth.columns(**{"kp_N_mm": 0.0, "force_zero_N": 0.0, **parameter_values, **more})


def by_scipy(psi, k, size, n, amplitude, samples, cycles):
    """The last of some cycles of u = A sin p from rest, by an integrator that knows nothing of steps in u."""

    def rate(p, z):
        u, du = amplitude * np.sin(p), amplitude * np.cos(p)
        ratio = np.abs(z[0]) / size
        return [k * (1.0 - psi[4 * (u > 0) + 2 * (du > 0) + (z[0] > 0)] * ratio**n) * du]

    z, force = 0.0, []
    for quarter in range(4 * cycles):  # so that no step goes across a jump of the signs of u or u̇
        start = 0.5 * np.pi * quarter
        grid = start + np.r_[1e-13, 2 * np.pi / samples * np.arange(1, samples // 4), np.pi / 2 - 1e-13]
        step = solve_ivp(rate, (grid[0], grid[-1]), [z], t_eval=grid, rtol=1e-9, atol=1e-11, max_step=0.05)
        z = step.y[0, -1]
        force.append(step.y[0, :-1])
    return np.concatenate(force[-4:])


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("amplitude", [0.2, 1.0])
def test_steady_loops_against_scipy(case, amplitude, truth):
    """Measured: at most 2.6e-4 of the RMS force, where n < 1 makes z's slope steep at zero 7e-4."""
    rival, parameter_values = parameter_values_of(case, truth)
    force = rival.force(parameter_values, sine_motion(frequency_hz=10.0, amplitude_mm=amplitude, samples=64))[0, 0]
    values = [float(parameter_values[name][0]) for name in ("bw_k_N_mm", "bw_force_N", "bw_n")]
    expected = by_scipy(rival.shape(parameter_values)[0], *values, amplitude, 64, 4)
    assert np.max(np.abs(force - expected)) < (3e-4 if values[2] >= 1.0 else 1e-3) * np.sqrt(np.mean(expected**2))


def test_small_loops_close_though_they_forget_slowly(truth):
    """k A = Z/20: hundreds of cycles would pass before a symmetric loop sits about zero; the secant finds it, from
    either side and however strong the specimen is."""
    rival, parameter_values = parameter_values_of("n = 2", truth)
    motion = sine_motion(frequency_hz=10.0, amplitude_mm=1.2 / 14.0 / 20.0)
    force = rival.force(parameter_values, motion)[0, 0]
    np.testing.assert_allclose(force[:64], -force[64:], atol=3e-5)
    assert np.max(force) > 0.04
    strong = parameter_values | truth.columns(bw_k_N_mm=14e3, bw_force_N=1.2e3)
    mirrored = motion.moved(-motion.displacement_mm, -motion.velocity_m_s, -motion.acceleration_m_s2)
    np.testing.assert_allclose(rival.force(strong, mirrored)[0, 0], -1e3 * force, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("case", CASES)
def test_loop_is_what_a_record_settles_to(case, truth):
    rival, parameter_values = parameter_values_of(case, truth, kp_N_mm=5.0, force_zero_N=0.3)
    t = np.arange(8 * 128 + 1) / (128 * 10.0)
    record = record_motion(t, 0.7 * np.sin(2 * np.pi * 10.0 * t))
    loop = rival.force(parameter_values, sine_motion(frequency_hz=10.0, amplitude_mm=0.7))[0, 0]
    settled = rival.force(parameter_values, record)[0, 0]
    np.testing.assert_allclose(settled[7 * 128 : 8 * 128], loop, atol=2e-4)
    assert recorded_force(rival, (), parameter_values, record)[0, 0, 0] == pytest.approx(0.3)


def test_frequency_does_not_matter_and_sampling_hardly(truth):
    for case in CASES:
        rival, parameter_values = parameter_values_of(case, truth)
        force = rival.force(parameter_values, sine_motion(frequency_hz=[10.0, 20.0], amplitude_mm=[0.6, 0.6]))[0]
        np.testing.assert_array_equal(force[0], force[1])
        fine = rival.force(parameter_values, sine_motion(frequency_hz=10.0, amplitude_mm=0.6, samples=1024))[0, 0]
        np.testing.assert_allclose(force[0], fine[::8], atol=3e-4)


def test_generalised_contains_wen(truth):
    rival, parameter_values = parameter_values_of("n = 2", truth, bw_share=0.65)
    general = parameter_values | truth.columns(bw_b2=-0.35, bw_b3=0.35, bw_b4=0.0, bw_b5=0.0, bw_b6=0.0)
    motion = sine_motion(frequency_hz=10.0, amplitude_mm=[0.05, 0.3, 1.0])
    np.testing.assert_allclose(
        GeneralizedBoucWen().force(general, motion), rival.force(parameter_values, motion), atol=3e-6
    )


def test_published_numbers(truth):
    """ψ as Song and Der Kiureghian print it, from their β's, is our ψ k/Zⁿ in every phase."""
    rival, parameter_values = parameter_values_of("asymmetric", truth)
    beta = {name: q.values for name, q in rival.derived(parameter_values).items()}
    for phase in range(8):
        u, du, z = (1.0 if phase & bit else -1.0 for bit in (4, 2, 1))
        printed = (
            beta["beta1"] * du * z
            + beta["beta2"] * u * du
            + beta["beta3"] * u * z
            + beta["beta4"] * du
            + beta["beta5"] * z
            + beta["beta6"] * u
        )
        assert rival.shape(parameter_values)[0, phase] * 14.0 / 1.2**1.7 == pytest.approx(printed[0], rel=1e-12)


def test_limits(truth):
    """Elastic while z is far below Z; Coulomb's rectangle where the spring is very stiff, without a step each."""
    rival, parameter_values = parameter_values_of("n = 2", truth, bw_force_N=1e4)
    motion = sine_motion(frequency_hz=10.0, amplitude_mm=1.0)
    np.testing.assert_allclose(rival.force(parameter_values, motion), 14.0 * motion.displacement_mm, atol=1e-3)
    rival, parameter_values = parameter_values_of("n = 2", truth, bw_k_N_mm=1e6)
    force = rival.force(parameter_values, motion)[0, 0]
    # a share below one half is no friction any more (z rests on the wrong side too), but must not cost a step each
    rival.force(parameter_values | truth.columns(bw_share=0.2, bw_k_N_mm=1e9), motion)
    turning = np.abs(motion.velocity_m_s[0, 0]) < 1e-9
    np.testing.assert_allclose(force[~turning], 1.2 * np.sign(motion.velocity_m_s[0, 0][~turning]), rtol=1e-5)


def test_asymmetry_is_within_reach_only_of_the_generalised(truth):
    motion = sine_motion(frequency_hz=10.0, amplitude_mm=1.0)
    wen = BoucWen().force(parameter_values_of("n = 2", truth)[1], motion)[0, 0]
    np.testing.assert_allclose(wen[:64], -wen[64:], atol=1e-4)
    rival, parameter_values = parameter_values_of("asymmetric", truth)
    force = rival.force(parameter_values, motion)[0, 0]
    assert np.max(np.abs(force[:64] + force[64:])) > 0.2


@pytest.mark.parametrize("rival", OTHER_MODELS.values(), ids=OTHER_MODELS)
def test_batches_and_broken_numbers(rival, truth):
    """Draws do not feel each other; NaN, and draws whose z runs away or never closes, give NaN and nothing else."""
    rng = np.random.default_rng(0)
    base = {
        "kp_N_mm": 5.0,
        "force_zero_N": 0.1,
        "bw_k_N_mm": 14.0,
        "bw_force_N": 1.2,
        "bw_n": 1.5,
        "bw_share": 0.6,
        "bw_b2": -0.4,
        "bw_b3": 0.4,
        "bw_b4": 0.1,
        "bw_b5": 0.1,
        "bw_b6": 0.1,
    }
    scales = Scales(1.0, 0.1, 5.0, 1.0, 6.0, 20.0)
    names = [p.name for p in rival.parameters(scales) if p.name != "force_zero_N"]
    parameter_values = {name: base[name] * np.exp(0.1 * rng.standard_normal(40)) for name in names}
    motion = sine_motion(frequency_hz=[10.0, 20.0], amplitude_mm=[0.3, 1.0])
    together = rival.force(parameter_values, motion)
    assert together.shape == (40, 2, 128) and np.all(np.isfinite(together))
    alone = rival.force({name: value[7:8] for name, value in parameter_values.items()}, motion)
    np.testing.assert_array_equal(alone[0], together[7])
    each = motion.moved(
        *(np.repeat(x, 40, axis=0) for x in (motion.displacement_mm, motion.velocity_m_s, motion.acceleration_m_s2))
    )
    np.testing.assert_array_equal(rival.force(parameter_values, each), together)
    for name in names:
        broken = parameter_values | {name: parameter_values[name].copy()}
        broken[name][3] = np.nan
        force = rival.force(broken, motion)
        assert np.all(np.isnan(force[3]))
        np.testing.assert_array_equal(np.delete(force, 3, axis=0), np.delete(together, 3, axis=0))
    for name in ("bw_k_N_mm", "bw_force_N", "bw_n"):
        broken = parameter_values | {name: parameter_values[name].copy()}
        broken[name][3] = -1.0
        assert np.all(np.isnan(rival.force(broken, motion)[3]))
    if isinstance(rival, GeneralizedBoucWen):
        runaway = {name: value[:1] for name, value in parameter_values.items()} | {"bw_b4": np.array([-30.0])}
        assert np.all(np.isnan(rival.force(runaway, sine_motion(frequency_hz=10.0, amplitude_mm=1.0))))
