"""Models that are not of the Iwan model's shape are identified and diagnosed, each with a planted effect found."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from bayes_iwan.campaign import write_campaign
from bayes_iwan.cli import main
from bayes_iwan.diagnosis.diagnosis import diagnose_loops
from bayes_iwan.effects.catalogue import variants
from bayes_iwan.effects.friction import StribeckWeakening
from bayes_iwan.effects.measuring_chain import ChannelDelay, ForceHighpass
from bayes_iwan.inference.results.run_files import load
from bayes_iwan.inference.setup.loop_scales import loop_energy_mJ
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.models import ModelError, record_motion, sine_motion
from bayes_iwan.models.bouc_wen import OTHER_MODELS
from bayes_iwan.models.simulator import inner_effects, recorded_force
from bayes_iwan.models.user_file import load_simulator

sys.path.insert(0, str(Path(__file__).parents[2] / "analyses"))

from other_models import PLANTED, SIMULATORS, made

SMALL = {"n_phase": 48, "n_harmonics": 16}


def simulator_of(name):
    return load_simulator(SIMULATORS / f"{name}.py")


def one(**parameter_values):
    return {k: np.array([float(v)]) for k, v in parameter_values.items()}


def test_damped_spring_dissipates_what_the_textbook_says():
    """∮F du = π η k A² + π c ω A², Eqs. of structural and viscous damping (Inman, Engineering Vibration, §2.7)."""
    motion = sine_motion(frequency_hz=[10.0, 20.0], amplitude_mm=[0.5, 1.0], samples=256)
    force = simulator_of("damped_spring").force(one(k_N_mm=6.0, eta=0.12, c_N_s_mm=2e-3), motion)
    a, w = np.array([0.5, 1.0]), 2.0 * np.pi * np.array([10.0, 20.0])
    expected = np.pi * a**2 * (0.12 * 6.0 + 2e-3 * w)
    np.testing.assert_allclose(loop_energy_mJ(motion.displacement_mm, force)[0], expected, rtol=1e-12)
    record = record_motion(np.arange(64) / 640.0, np.sin(np.arange(64) / 10.0))
    with pytest.raises(ModelError, match="steady loops only"):
        simulator_of("damped_spring").force(one(k_N_mm=6.0, eta=0.12, c_N_s_mm=2e-3), record)


def test_dahl_is_wens_model_with_exponent_and_share_one():
    """dz/du = σ (1 − z/Z sgn u̇) by exponentials, against Wen's equation by Runge–Kutta; a record settles to it."""
    dahl, parameter_values = simulator_of("dahl"), one(kp_N_mm=5.0, dahl_force_N=1.2, dahl_k_N_mm=15.0)
    motion = sine_motion(frequency_hz=10.0, amplitude_mm=[0.05, 0.7, 2.0], samples=256)
    loop = dahl.force(parameter_values, motion)
    wen = one(kp_N_mm=5.0, bw_k_N_mm=15.0, bw_force_N=1.2, bw_n=1.0, bw_share=1.0)
    np.testing.assert_allclose(loop, OTHER_MODELS["bouc_wen"].force(wen, motion), atol=1e-4)
    time = np.arange(6 * 256) / 2560.0
    settled = dahl.force(parameter_values, record_motion(time, 0.7 * np.sin(2.0 * np.pi * 10.0 * time)))[0, 0]
    np.testing.assert_allclose(settled[5 * 256 :], loop[0, 1], atol=1e-9)


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_effect_is_found(name):
    campaign = made(name)
    found = diagnose_loops(campaign, campaign.loops(**SMALL), seed=1, quick=True, simulator=simulator_of(name))
    assert found.verdict.cause == PLANTED[name][1] and found.verdict.causes[0].probability > 0.6
    assert found.verdict.causes[0].share.value > 0.9
    strength, true = next(iter(PLANTED[name][2].items()))
    assert found.parameters[PLANTED[name][1]][strength].mean == pytest.approx(true, rel=0.25)
    # no elements, so nothing is said of what sticks
    assert found.where.sticking is None
    assert not {"microslip", "gross slip"} & {x.name for x in found.where.of("region")}


def test_friction_effects_are_offered_only_where_the_simulator_has_their_stage():
    spring, dahl = simulator_of("damped_spring"), simulator_of("dahl")
    assert "stribeck_weakening" not in variants((), spring) and "normal_force_lag" not in variants((), dahl)
    assert {"channel_delay", "viscous_damping", "rig_compliance"} < set(variants((), spring))
    assert "stribeck_weakening" in variants((), dahl)
    problem = make_problem(made("damped_spring").loops(**SMALL), None, spring)
    with pytest.raises(ModelError, match="stribeck_weakening acts on slip"):
        problem.with_effects([StribeckWeakening(problem.scales)])


@pytest.mark.parametrize("rival", OTHER_MODELS.values(), ids=OTHER_MODELS)
def test_a_rival_s_force_honours_effects(rival):
    """A late force channel turns a rival's harmonics as it turns any; a high-pass takes its mean."""
    problem = make_problem(made("dahl").loops(**SMALL), None, rival)
    delay = ChannelDelay(problem.scales)
    extended = problem.with_effects([delay])
    z = np.zeros((1, extended.ndim))
    z[0, extended.names.index("channel_delay.delay_s")] = 1.0
    late = float(extended.prior.values(z)["channel_delay.delay_s"][0])
    parameter_values = extended.parameter_values(z)
    plain = np.fft.rfft(problem.force(parameter_values)[0], axis=-1)
    turned = np.fft.rfft(extended.force(parameter_values)[0], axis=-1)
    f = problem.motion.frequency_hz[:, None] * np.arange(plain.shape[1])
    np.testing.assert_allclose(turned[:, :9], (plain * np.exp(-2j * np.pi * f * late))[:, :9], atol=1e-9)
    high = ForceHighpass(problem.scales)
    own = {p.name: p.value(np.zeros(1)) for p in high.parameters}
    through = recorded_force(
        rival, (high,), {**parameter_values, **own, "force_zero_N": np.array([0.5])}, problem.motion
    )
    assert np.all(np.abs(through.mean(axis=-1)) < 1e-3)
    assert inner_effects(extended.effects) == ()


@pytest.mark.usefixtures("no_pictures", "few_quick_walkers")
def test_own_simulator_by_the_command_line(tmp_path, capsys):
    """identify --simulator: numbers come back, pages and tables hold nothing of slip forces, results load again."""
    name = "damped_spring"
    campaign = made(name)
    write_campaign(tmp_path / "campaign", name="spring", description="", tests=campaign.tests)
    config = tmp_path / "short.toml"
    config.write_text(
        "[loops]\nn_phase = 48\nn_harmonics = 16\n[search]\nmembers = 40\nevaluations = 800\nsecond_search = false\n"
        "[sampling]\nensembles = 2\nwalkers = 24\nbudget_s = 60.0\nr_hat = 1.1\ness = 50.0\ntaus = 5.0\ndraws = 400\n"
    )
    file = SIMULATORS / f"{name}.py"
    out = tmp_path / "run"
    arguments = ["identify", str(tmp_path / "campaign"), "--simulator", str(file), "--config", str(config)]
    assert main([*arguments, "--out", str(out)]) in (0, 3)
    assert "k_N_mm" in capsys.readouterr().out
    with pytest.raises(ValueError, match=r"a Python file that is not run unasked; name it"):
        load(out)
    assert main(["report", str(out)]) == 2 and "not run unasked" in capsys.readouterr().err
    posterior = load(out, simulator=file)
    rows = {r.name: r for r in posterior.summary()}
    # the planted cubic spring stiffens it: the fitted stiffness lies between that at rest and the secant at 1 mm
    assert 6.0 < rows["k_N_mm"].q50 < 6.4
    page = (out / "report.html").read_text()
    assert "damped_spring" in page and "lip force" not in page.replace("stiffnesses and slip forces", "")
    assert not any(n.startswith(("slip_force", "alpha_", "mean_slip")) for n in rows)


OWN = """
import bayes_iwan as bi
from scipy import stats


class Spring(bi.Simulator):
    name = "spring"

    def parameters(self, scales):
        return [bi.Parameter(n, "k", "N/mm", "spring", {prior}) for n in {names}]

    def force(self, parameter_values, motion, effects=()):
        return parameter_values["{read}"][:, None, None] * motion.displacement_mm
"""


@pytest.mark.parametrize(
    ("names", "prior", "read", "says"),
    [
        (["k_N_mm"], "stats.norm(5.0, 1.0)", "k", r"bayes-iwan: own\.py, line 13: KeyError: 'k'; fix the file$"),
        (
            ["k_N_mm"],
            "stats.norm",
            "k_N_mm",
            r"k_N_mm: the prior must be a frozen distribution of scipy\.stats, such as",
        ),
        (["k_N_mm"] * 2, "stats.norm(5.0, 1.0)", "k_N_mm", r"parameter names repeat: \['k_N_mm', 'k_N_mm'\]"),
    ],
)
def test_a_mistake_in_a_user_s_file_is_not_called_a_defect_of_ours(names, prior, read, says, tmp_path, capsys):
    path, campaign = tmp_path / "own.py", tmp_path / "campaign"
    write_campaign(campaign, name="spring", description="", tests=made("damped_spring").tests)
    path.write_text(OWN.format(names=names, prior=prior, read=read))
    for command in ("identify", "diagnose"):
        assert main([command, str(campaign), "--out", str(tmp_path / "out"), "--quick", "--simulator", str(path)]) == 2
        printed = capsys.readouterr().err.strip()
        assert re.search(says, printed.splitlines()[-1]) and "defect" not in printed


def test_a_bad_simulator_is_one_line(tmp_path, capsys):
    path, campaign = tmp_path / "own.py", tmp_path / "campaign"
    write_campaign(campaign, name="spring", description="", tests=made("damped_spring").tests)
    for text, says in (
        ("x = 1\n", "defines no subclass"),
        ("from bayes_iwan import Simulator\nclass A(Simulator):\n    name = 'a'\n", "A lacks force, parameters"),
        ("import nothing_of_that_name\n", "nothing_of_that_name"),
        (
            "from bayes_iwan import Simulator\n"
            + "".join(
                f"class {n}(Simulator):\n    name = '{n}'\n    parameters = force = lambda *a: ()\n" for n in "AB"
            ),
            "several simulators",
        ),
    ):
        path.write_text(text)
        assert main(["diagnose", str(campaign), "--out", str(tmp_path / "out"), "--simulator", str(path)]) == 2
        printed = capsys.readouterr().err
        assert says in printed and printed.count("\n") == 1
