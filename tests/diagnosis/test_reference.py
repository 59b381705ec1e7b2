"""Whole diagnoses say what they said."""

import pytest

from bayes_iwan.files import finite


@pytest.mark.parametrize(
    "effect, plan",
    [
        ("viscous_damping", "held out"),
        ("channel_delay", "grid"),
        ("friction_fade", "grid"),
        ("cell_hysteresis", "grid"),
        ("viscous_damping", "grid"),
        ("base_resonance", "grid"),
        (None, "single"),
        ("force_clipping", "grid"),
        ("free_play", "no clock"),
    ],
)
def test_a_diagnosis_is_what_it_was(kit, reference, effect, plan):
    """A named cause and held-out tests, ties, what changes along the record, a foreign cause, what the base can imitate
    and the test that would tell, one of a set, none, a limit of the force, and rows without a time."""
    found = kit.diagnosed(effect, plan)
    scores = {"+".join(sorted(names)): x for names, x in found.search.scores.items()}
    reference({"answer": finite(found.to_dict()), "scores": scores})
