"""Effects that look alike do not stand side by side in an answer where one of them would do."""

from itertools import combinations

import numpy as np

from bayes_iwan.campaign import average
from bayes_iwan.diagnosis.answer.saved_fits import LOOPS
from bayes_iwan.diagnosis.diagnosis import searched
from bayes_iwan.diagnosis.fits.data import gap_data
from bayes_iwan.diagnosis.search.candidates import in_place, on_top
from bayes_iwan.diagnosis.search.search_result import LAST, look_alike
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.virtual_rig import cases


def test_a_last_exchange_does_not_leave_two_that_look_alike():
    """A Bessel filter of the force: delay and low-pass each stand in for the other, and the search ends in a set that
    it had only passed, with one exchange more."""
    case = cases.draw_case(np.random.default_rng([68003, 60]), None, laws="other")
    assert [(f.name, f.law) for f in case.faults] == [("force_lowpass", "bessel")]
    loops = [average(r, **LOOPS) for r in cases.simulate(case)[0] if r.role != "held-out"]
    found = searched(gap_data(loops), DiagnoseSettings(), 0)
    assert {"channel_delay", "force_lowpass"} & set(found.chosen)
    causes = [n for n in found.chosen if n not in LAST]  # what bends the base's form may stand beside any
    assert not [pair for pair in combinations(causes, 2) if look_alike(found.effects, *pair)]


def test_what_takes_the_place_of_another_effect_starts_where_it_does_the_same(kit):
    """A late force: each law of a low-pass delays as much, in a base that is left as it was."""
    found = kit.diagnosed("channel_delay").search
    late = found.fit({"channel_delay"})
    values = late.problem.parameter_values(late.z[None])
    for law in found.effects["force_lowpass"]:
        problem = on_top(found.base, law)
        z = in_place(found.data, late, problem, law)
        assert [z[problem.names.index(n)] for n in found.base.problem.names] == [
            late.z[late.problem.names.index(n)] for n in found.base.problem.names
        ]
        tau = problem.parameter_values(z[None])["force_lowpass.tau_s"]
        np.testing.assert_allclose(tau, values["channel_delay.delay_s"], rtol=0.1)
