"""Effects with numbers of their own in every test: which of them are tried."""

from dataclasses import replace

import numpy as np

from bayes_iwan.campaign import Campaign
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.search import model_search as searching
from bayes_iwan.diagnosis.search import refits
from bayes_iwan.diagnosis.search.candidates import candidate
from bayes_iwan.diagnosis.search.fitted_sets import FittedSets, silent
from bayes_iwan.diagnosis.search.model_search import fit_singles
from bayes_iwan.effects import catalogue
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.virtual_rig.planning import simulate_campaign
from bayes_iwan.virtual_rig.simulate import PlannedTest


def test_a_mains_line_that_every_loop_hides_is_refitted_whatever_a_step_promises(kit, monkeypatch):
    """At 6 Hz 60 Hz is a harmonic of every test; at 7 Hz records show that there is none."""
    monkeypatch.setattr(refits, "candidate", lambda *given: replace(candidate(*given), gain=-1e3, score=-1e3))
    monkeypatch.setattr(searching, "SINGLE_MOST", 0)
    monkeypatch.setattr(searching, "as_sound", lambda found: False)
    for hz, tried in ((6.0, True), (7.0, False)):
        made = simulate_campaign([PlannedTest(hz, a, cycles=12) for a in (0.4, 0.9)], seed=3)
        data = gap_data(Campaign("virtual rig", "", "", "", None, made.records).loops(**kit.small))
        kinds, rng = {"mains_interference": catalogue.variants()["mains_interference"]}, np.random.default_rng(0)
        found = FittedSets(data, scales_of(data.loops), kit.settings, kinds, rng, silent, None, None)
        fit_singles(found)
        assert (frozenset({"mains_interference"}) in found.fits) is tried
