"""Effects with numbers of their own in every test: which of them are tried."""

import numpy as np

from bayes_iwan.campaign import Campaign
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.search.fitted_sets import FittedSets, silent
from bayes_iwan.effects import catalogue
from bayes_iwan.effects.along_record import MainsInterference
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.virtual_rig.planning import simulate_campaign
from bayes_iwan.virtual_rig.simulate import PlannedTest


def test_a_mains_line_that_every_loop_hides_is_tried_alone_wherever_there_is_a_gap(kit):
    """At 6 Hz 60 Hz is a harmonic of every test; at 7 Hz records show that there is none."""
    assert MainsInterference.sudden
    for hz, tried in ((6.0, True), (7.0, False)):
        made = simulate_campaign([PlannedTest(hz, a, cycles=12) for a in (0.4, 0.9)], seed=3)
        data = gap_data(Campaign("virtual rig", "", "", "", None, made.records).loops(**kit.small))
        kinds, rng = {"mains_interference": catalogue.variants()["mains_interference"]}, np.random.default_rng(0)
        found = FittedSets(data, scales_of(data.loops), kit.settings, kinds, rng, silent, None, None)
        assert [x.name for x in found.offered(found.base)] == ["mains_interference"] * tried
