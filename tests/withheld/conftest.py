"""What the tests of the protocol and of the studies share."""

import pytest

from bayes_iwan.virtual_rig import cases as rig_cases
from bayes_iwan.virtual_rig.simulate import PlannedTest


def _small(rng):
    f = float(rng.uniform(8, 12))
    tests = tuple(PlannedTest(round(f * k, 1), a, 6, 4) for k, a in ((1, 0.4), (2, 0.9)))
    return tests, (PlannedTest(round(1.5 * f, 1), 0.7, 6, 4),)


@pytest.fixture(scope="module")
def small_design():
    """Two short tests a case: the protocol is on trial, not the rig."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig_cases, "draw_design", _small)
        yield
