"""From a planted fault to its name: campaigns drawn on the virtual rig, which shares no code with the model, diagnosed.

Viscous damping, a moving mass and a delay between the channels are named in `test_search.py`; with those here they are
eleven.
"""

import pytest

from bayes_iwan.diagnosis.assessment.budget import Kind
from bayes_iwan.diagnosis.diagnosis import diagnose_loops

PLANTED = (
    "quadratic_stiffness",
    "end_stop",
    "friction_fade",
    "rate_strengthening",
    "force_highpass",
    "force_clipping",
    "force_drift",
    "mains_interference",
)


def test_what_four_tests_hardly_tell_apart_is_said_with_the_name(kit):
    """Of two frequencies either alone takes a relaxation for viscous damping, and predicts the other badly."""
    campaign = kit.campaign_of(kit.rig_records("maxwell_branch"))
    loops = campaign.loops(n_phase=36, n_harmonics=12)
    found = diagnose_loops(campaign, loops, seed=1, quick=True, settings=kit.settings)
    (cause,), said = found.verdict.causes, " ".join(found.sentences())
    assert cause.name == "maxwell_branch" and "viscous_damping" in cause.tied_with
    assert cause.held_out.value < 0.0 and "but nothing on held-out tests, where its numbers do not hold" in said
    assert "cannot tell it from viscous damping" in said and "It separates a Maxwell branch and viscous damping" in said


@pytest.mark.parametrize("cause", PLANTED)
def test_the_verdict_names_the_planted_cause(cause, kit):
    campaign = kit.campaign_of(kit.rig_records(cause))
    loops = campaign.loops(n_phase=36, n_harmonics=12)
    found = diagnose_loops(campaign, loops, seed=1, quick=True, settings=kit.settings)
    assert found.verdict.names == (cause,) and found.verdict.kind == Kind.EXPLAINED
    assert found.verdict.causes[0].share.value > 0.7
