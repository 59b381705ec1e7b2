"""With a small smooth discrepancy correlated errors give intervals that cover; independent ones do not (at reduced
size)."""

import numpy as np


def test_a_smooth_misfit_needs_correlated_errors():
    """48 intervals of 90 %: some 43 should hold the truth. Full size: analyses/coverage_discrepancy.py."""
    from coverage_discrepancy import clopper_pearson, coverage

    hits = {kind: int(np.sum(x)) for kind, x in coverage(16, ("correlated", "gaussian"), progress=False).items()}
    assert clopper_pearson(hits["correlated"], 48)[1] > 0.9 and hits["correlated"] >= 37
    assert clopper_pearson(hits["gaussian"], 48)[1] < 0.75
