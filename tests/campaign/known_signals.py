"""A known signal of a friction loop, drawn by Hypothesis, and how it is compared with what an import makes of it.

12 examples a form, or as many as BAYES_IWAN_EXAMPLES says.
"""

import os
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from bayes_iwan.campaign import CampaignError
from bayes_iwan.campaign.importing import Recipe, import_tests

EXAMPLES = int(os.environ.get("BAYES_IWAN_EXAMPLES", "12"))
form = settings(
    max_examples=EXAMPLES, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@st.composite
def signals(draw):
    """Rate (Hz), displacement (mm) and force (N) of a friction loop, of other frequency, size and length each time."""
    rate = draw(st.sampled_from([200.0, 250.0, 1000.0, 1280.0]))
    per_cycle = draw(st.integers(24, 90)) + draw(st.sampled_from([0.0, 0.37]))
    cycles = draw(st.floats(5.3, 9.0))
    amplitude = draw(st.floats(0.2, 3.0))
    p = 2 * np.pi * np.arange(int(per_cycle * cycles)) / per_cycle + draw(st.floats(0.0, 6.0))
    force = draw(st.floats(20.0, 3000.0)) * (np.sin(p + 0.4) + 0.15 * np.sin(3 * p + 0.9))
    return rate, amplitude * np.sin(p), force


def back(write, recipe=None, rtol=1e-6, shift=0, **options):
    """Write into a folder by write(folder) -> path, import, and give the record."""
    with tempfile.TemporaryDirectory() as folder:
        found = import_tests([write(Path(folder))], recipe or Recipe(), **options)
    assert len(found) == 1
    return found[0].record


def back_or_said(write, words):
    """The same; None where too little is left of the record, and that is said."""
    try:
        return back(write)
    except CampaignError as error:
        assert words in str(error)
        return None


def same(record, rate, x, f, digits=5, time_digits=6):
    """The record holds the signal within what so many digits behind the point round."""
    n = record.time_s.size
    assert abs(n - x.size) <= 1
    np.testing.assert_allclose(record.displacement_mm, x[:n], atol=0.51 * 10.0**-digits + 1e-9 * np.abs(x).max())
    np.testing.assert_allclose(record.force_N, f[:n], atol=0.51 * 10.0**-digits + 1e-9 * np.abs(f).max())
    np.testing.assert_allclose(record.time_s - record.time_s[0], np.arange(n) / rate, atol=1.01 * 10.0**-time_digits)
