"""A user's own effect in one file: loaded, checked, and given the strength that the catalogue's effects have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayes_iwan.effects.base import EffectError
from bayes_iwan.effects.catalogue import BUILT_IN, variants
from bayes_iwan.effects.user_file import load_effects
from bayes_iwan.inference.scales import Scales
from bayes_iwan.physics import sine_motion

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


def test_it_joins_the_catalogue_and_a_taken_name_is_refused():
    kinds = variants(load_effects(FILE))
    assert "quadratic_drag" in kinds and len(kinds) == len(variants()) + 1
    with pytest.raises(EffectError, match="exists already"):
        variants(BUILT_IN[:1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1\n", "defines no subclass"),
        ("from bayes_iwan.effects import Effect\nclass A(Effect):\n    name = 'a'\n", "A lacks strength"),
        ("import not_a_module_at_all\n", "cannot be run"),
    ],
)
def test_a_file_that_cannot_be_used_says_why(tmp_path, text, message):
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(EffectError, match=message) as error:
        load_effects(path)
    assert "mine.py" in str(error.value)


def test_a_missing_file_says_so(tmp_path):
    with pytest.raises(EffectError, match=r"nowhere\.py: no such file"):
        load_effects(tmp_path / "nowhere.py")
