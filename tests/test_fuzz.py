"""A fixed sample of analyses/fuzz.py: damaged files of every kind are refused in one line or read, and nothing else."""

import os

import pytest


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the readers run in a forked process")
def test_damaged_files_are_refused_in_one_line_or_read(monkeypatch, tmp_path):
    for module in ("h5py", "nptdms", "pyuff", "pyarrow"):
        pytest.importorskip(module)
    import fuzz

    monkeypatch.setattr(fuzz, "TRIED", 6)
    log = tmp_path / "log"
    found = fuzz.fuzz(0, seed=11, log=log)
    assert len(found) == 30
    for name, tally in found.items():
        assert not tally.bad and sum(tally.counts.values()) == 6, (name, tally, log.read_text())
    # how many of a kind are refused follows from where the sample strikes, and a checkpoint's damaged end is read on
    # purpose: only where a checksum covers the whole file is every change refused
    assert found["posterior.nc"].counts["refused"] == 6
    every = sum((t.counts for t in found.values()), start=type(found["config"].counts)())
    assert every["refused"] > 50 and every["read"] > 15
