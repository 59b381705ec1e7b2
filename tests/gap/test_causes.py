"""From a planted fault to its name: campaigns drawn on the virtual rig, which shares no code with the model, diagnosed.

Viscous damping and a delay between the channels are named in `test_search.py`; with those here they are twelve.
"""

import pytest

from bayes_iwan.gap.diagnosis import diagnose_loops
from bayes_iwan.gap.judging.budget import Kind

PLANTED = (
    "moving_mass",
    "quadratic_stiffness",
    "end_stop",
    "friction_fade",
    "rate_strengthening",
    "maxwell_branch",
    "force_highpass",
    "force_clipping",
    "force_drift",
    "mains_hum",
)


@pytest.mark.parametrize("cause", PLANTED)
def test_the_verdict_names_the_planted_cause(cause, kit):
    campaign = kit.campaign_of(kit.rig_records(cause))
    loops = campaign.loops(n_phase=36, n_harmonics=12)
    found = diagnose_loops(campaign, loops, seed=1, quick=True, settings=kit.settings)
    assert found.verdict.names == (cause,) and found.verdict.kind == Kind.EXPLAINED
    assert found.verdict.causes[0].share.value > 0.7
