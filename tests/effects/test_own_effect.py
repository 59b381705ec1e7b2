"""A user's own effect in one file: loaded, checked, and given the strength that the catalogue's effects have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayes_iwan.effects.base import Effect, EffectError
from bayes_iwan.effects.catalogue import load_effects, variants
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.models import Model, sine_motion
from bayes_iwan.models.simulator import recorded_force

FILE = Path(__file__).parents[2] / "analyses" / "effects" / "quadratic_drag.py"
SCALES = Scales(1.0, 0.2, 5.0, 1.0, 6.0, 20.0)


def test_the_example_is_loaded_and_acts_as_it_says():
    (drag,) = load_effects(FILE)
    effect = drag(SCALES)
    motion = sine_motion(frequency_hz=[10.0, 10.0], amplitude_mm=[0.5, 1.0])
    parameter_values = {"quadratic_drag.c2_N_s2_m2": np.array([0.0, 10.0])}
    added = effect.force(np.zeros((2, 2, 128)), motion, parameter_values)
    assert not added[0].any()  # neutral at zero
    speed = 2e-3 * np.pi * 10.0
    assert added[1, 1].max() == pytest.approx(10.0 * speed**2)
    assert added[1, 1].max() == pytest.approx(4.0 * added[1, 0].max())  # ∝ amplitude squared
    assert np.all(added[1] * motion.velocity_m_s[0] >= 0.0)  # against the motion: it dissipates
    strength = effect.parameters[0]
    assert strength.name == "quadratic_drag.c2_N_s2_m2" and strength.unit == "N·s²/m²"
    # the prior's median is what the effect itself calls a strength of the right order
    assert float(strength.value(np.zeros(1))[0]) == pytest.approx(effect.first_guess())


def test_it_joins_the_catalogue():
    kinds = variants(load_effects(FILE))
    assert "quadratic_drag" in kinds and len(kinds) == len(variants()) + 1


@pytest.mark.parametrize("name", ["viscous_damping", "none", "unknown"])
def test_taken_names_are_refused(name):
    with pytest.raises(EffectError, match="choose another name"):
        variants([type("Own", (Effect,), {"name": name})])


GOOD = """
from bayes_iwan.effects import Effect

class Softening(Effect):
    name = "softening"
    strength = ("share", "s", "-", "share of the force that is lost")
    physics = "force fades"
    reference = "none"
    signature = "smaller loops"

    def first_guess(self):
        return 0.1

    def force(self, force_N, motion, numbers):
        return force_N * (1.0 - self.get(numbers, "share"))
"""


def test_it_acts_on_the_recorded_force(tmp_path, kit):
    path = tmp_path / "own.py"
    path.write_text(GOOD)
    (kind,) = load_effects(path)
    model, at = Model(kit.reference), sine_motion(frequency_hz=20.0, amplitude_mm=[0.9, 0.3], samples=48)
    parameter_values = kit.parameter_values(model) | {"softening.share": np.array([0.25])}
    force = recorded_force(model, (kind(kit.scales),), parameter_values, at)
    np.testing.assert_allclose(force, 0.75 * model.force(parameter_values, at))


@pytest.mark.parametrize(
    "text, says",
    [
        ("x = 1\n", "no subclass"),
        ("def f(:\n", "cannot be run"),
        ("import nothing_of_that_name\n", "nothing_of_that_name"),
        (GOOD.replace('    signature = "smaller loops"\n', ""), "lacks signature"),
        (GOOD.replace("def first_guess", "def another"), "lacks first_guess"),
        (GOOD.replace('    strength = ("share", "s", "-", "share of the force that is lost")\n', ""), "lacks strength"),
        (GOOD.replace('("share", "s", "-", "share of the force that is lost")', '"share"'), "strength"),
        (GOOD.replace('"softening"', '"soft.ening"'), "name"),
        (GOOD.replace("def force", "def forces"), "acts nowhere: give it a method motion, around, force, "),
        (GOOD.replace("return 0.1", "return 0.0"), "first_guess = 0.0; it must be positive"),
        (GOOD.replace("(1.0 -", "(1.1 -"), "N at strength 0; it must change none"),
        (
            GOOD.replace("force_N * (", "float('nan') * force_N * ("),
            "by nan N at strength 0",
        ),
        (
            GOOD.replace("return force_N *", "return force_N[0] *").replace('"share"))', '"share")[0])'),
            "shape (1, 128), not (draws, tests, samples) (2, 1, 128)",
        ),
        (GOOD.replace("        return force_N", "        force_N"), "gives arrays of shape ()"),
        (
            GOOD.replace("        return force_N", "        motion.velocity_m_s[:] *= 2.0\n        return force_N"),
            "a copy",
        ),
    ],
)
def test_bad_effect_files_are_named_with_the_fix(text, says, tmp_path):
    path = tmp_path / "own.py"
    path.write_text(text)
    with pytest.raises(EffectError) as error:
        load_effects(path)
    assert str(path) in str(error.value) and says in str(error.value) and "\n" not in str(error.value)


def test_a_missing_file_says_so(tmp_path):
    with pytest.raises(EffectError, match=r"nowhere\.py: no such file"):
        load_effects(tmp_path / "nowhere.py")
