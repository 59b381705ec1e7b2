"""A fixed sample of analyses/fuzz.py: damaged files of every kind are refused in one line or read, and nothing else."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "analyses"))


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="the readers run in a forked process")
def test_damaged_files_are_refused_in_one_line_or_read():
    from fuzz import fuzz

    found = fuzz(18 * 9, seed=11)
    assert len(found) == 9
    for name, counts in found.items():
        assert set(counts) <= {"refused", "read", "peak MB"} and counts["refused"] > 3, (name, counts)
    assert found["posterior.nc"]["read"] == 0
