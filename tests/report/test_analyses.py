"""The analyses' own arithmetic: the stepwise isolator against the model and against mechanics, folds and coverage."""

from __future__ import annotations

import ast
import inspect
from contextlib import suppress
from functools import reduce
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_iwan.models import sine_motion
from bayes_iwan.report.identification.predictive import predict


@pytest.fixture(scope="module")
def design():
    return import_module("design_isolator")


def test_stepwise_force_is_the_model_s(design, posterior):
    phi, p = design.element_values(posterior, 2)
    motion = sine_motion(frequency_hz=[15.0], amplitude_mm=[0.6], samples=2000)
    model = posterior.problem.model.force(posterior.problem.parameter_values(posterior.flat_z(2)), motion)[:, 0]
    u, v = motion.displacement_mm[0, 0], 1e3 * motion.velocity_m_s[0, 0]
    for d in range(2):
        x = np.zeros(phi.shape[1])
        for _ in range(2):
            force = np.array([design.force(a, b, 0.6, x, phi[d], p[d]) for a, b in zip(u, v)])
        friction = model[d] - p[d, 0] * u
        assert np.sqrt(np.mean((force - model[d]) ** 2)) < 0.01 * np.std(friction)


def test_stuck_elements_make_a_linear_oscillator(design):
    phi = np.full((1, 8), 1e6)
    p = np.array([[5.0, 15.0, 0.0, 0.0, 0.0, 1.0, 1.0, 100.0, 0.0, 0.0]])  # kp 5, k1 15 N/mm, α = 1
    hz = np.array([5.0, 60.0])
    ratio, _ = design.sweep(hz, 30, 0.1, 1.0, phi, p)
    natural = np.sqrt(20e3) / (2 * np.pi)
    pulse = np.zeros(4000)
    pulse[:20] = 5e4
    stretch, acceleration = design.shock(pulse, 5e-5, 1.0, phi, p)
    crossings = np.flatnonzero(np.diff(np.sign(stretch[0, 20:])) != 0)
    assert 1.0 / (2 * np.mean(np.diff(crossings)) * 5e-5) == pytest.approx(natural, rel=0.01)
    # an undamped oscillator keeps its transient, so far below resonance is all that can be told of the sweep
    assert ratio[0, 0] == pytest.approx(1 / (1 - (5.0 / natural) ** 2), rel=0.15)
    assert np.max(np.abs(acceleration[0] + 20.0 * stretch[0] - 20.0 * np.diff(stretch[0], prepend=0))) < 0.2


def test_design_figure(design, posterior, capsys):
    figure = design.figure(posterior, draws=3, hz=np.array([8.0, 12.0, 14.0, 30.0]), cycles=8)
    assert len(figure.axes) == 4 and "resonance" in capsys.readouterr().out


def test_folds_and_coverage(posterior):
    untested = import_module("predict_untested")
    folds = untested.folds(posterior.problem.loops)
    assert folds["10 Hz"] == ["f10_a0.4.csv", "f10_a1.csv"] and folds["1 mm"] == ["f10_a1.csv", "f20_a1.csv"]
    p = predict(posterior, [x for x in posterior.loops if x.role == "held-out"])
    half, most = untested.coverage(p, 0.5), untested.coverage(p, 0.9)
    # one loop has some forty independent numbers
    assert 0.8 < most.points <= 1.0 and 0.35 < half.points < 0.75
    assert len(untested.figure({"15 Hz": p}).axes) == 1


SCRIPTS = sorted(p.stem for p in (Path(__file__).parents[2] / "analyses").glob("*.py"))


@pytest.mark.parametrize("name", SCRIPTS)
def test_every_script_finds_what_it_takes_from_the_package_and_says_how_it_is_run(name):
    script = import_module(name)
    text = Path(script.__file__).read_text(encoding="utf-8")
    assert ("__main__" in text) == (f"analyses/{name}.py" in script.__doc__)
    assert not [*wrong_calls(script, text)]


def wrong_calls(script, text):
    """Calls of what a script has by name, whose arguments that does not take: what a type checker would find in files
    that have no types."""
    for call in (x for x in ast.walk(ast.parse(text)) if isinstance(x, ast.Call)):
        named, (first, *rest) = [k.arg for k in call.keywords], ast.unparse(call.func).split(".")
        # no function of its own, or none with a signature
        with suppress(KeyError, AttributeError, ValueError, TypeError):
            signature = inspect.signature(reduce(getattr, rest, vars(script)[first]))
            if None in named or any(isinstance(x, ast.Starred) for x in call.args):
                continue
            try:
                signature.bind(*call.args, **dict.fromkeys(named))
            except TypeError as error:
                yield f"line {call.lineno}: {ast.unparse(call)}: {error}"


def test_a_call_with_a_missing_argument_is_found():
    text = "exists('a')\nexists()\nlater(1)\nexists(*some)"
    assert [x[:16] for x in wrong_calls(SimpleNamespace(exists=lambda path: path), text)] == ["line 2: exists()"]


@pytest.mark.usefixtures("few_quick_walkers")
def test_loops_of_table_1_tell_the_product_alone(tmp_path):
    """Identified for two seconds, k̃ₙβ is found within some percent while β wanders far more."""
    paper = import_module("reproduce_paper")
    model, parameter_values = paper.Model(paper.REFERENCE), paper.table_1(paper.REFERENCE)
    posterior = paper.identified(model, parameter_values, 2.0)
    draws = {name: q.values for name, q in posterior.derived().items()}
    product = draws["kn_1_mm"] * draws["beta"]
    assert np.median(product) == pytest.approx(1.79 * 0.0062, rel=0.1)
    assert np.std(np.log(draws["beta"])) > 3 * np.std(np.log(product))
    assert "k̃ₙβ" in paper.figure_posterior(posterior, tmp_path)
    assert (tmp_path / "posterior_normal_force.png").stat().st_size > 5000
