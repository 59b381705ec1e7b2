"""The journal of a run: what is cut or changed of it never becomes a draw."""

import numpy as np
import pytest

from bayes_iwan.sampling.checkpoint import Checkpoint, CheckpointError, read_checkpoint


def small_checkpoint(path):
    """Two commits of three draws each; the bytes of the file after each."""
    file = Checkpoint.create(path, {}, ("x",), 4, {"i": np.array(0.0)})
    ends = [path.stat().st_size]
    for i in (1.0, 2.0):
        file.commit(np.full((3, 4, 1), i), np.full((3, 4), i), {"i": np.array(i), "kept": np.arange(5)})
        ends.append(path.stat().st_size)
    file.close()
    return ends


def test_a_commit_that_is_cut_short_falls_back_to_the_one_before(tmp_path):
    path = tmp_path / "run"
    start, first, end = small_checkpoint(path)
    whole = path.read_bytes()
    assert read_checkpoint(path).draws[:, 0, 0].tolist() == [1, 1, 1, 2, 2, 2]
    for cut in range(first, end, 7):
        path.write_bytes(whole[:cut])
        snapshot = read_checkpoint(path)
        assert snapshot.state["i"] == 1.0
        assert snapshot.draws.shape == (3, 4, 1)
    file, _ = Checkpoint.resume(path, {}, ("x",))  # what was cut is drawn again, and the file is whole again
    file.commit(np.full((3, 4, 1), 2.0), np.full((3, 4), 2.0), {"i": np.array(2.0), "kept": np.arange(5)})
    file.close()
    assert path.read_bytes() == whole
    for cut in range(start):
        path.write_bytes(whole[:cut])
        with pytest.raises(CheckpointError, match=r"run: (not a checkpoint|damaged at its start)"):
            read_checkpoint(path)


def test_no_changed_byte_changes_a_draw(tmp_path):
    path = tmp_path / "run"
    start, first, _ = small_checkpoint(path)
    whole = path.read_bytes()
    for at in range(0, len(whole), 5):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :])
        if at < start:
            with pytest.raises(CheckpointError, match=r"run: "):
                read_checkpoint(path)
            continue
        snapshot = read_checkpoint(path)
        kept = [1.0] * 3 if at >= first else []
        assert snapshot.draws[:, 0, 0].tolist() == kept and snapshot.state["i"] == len(kept) / 3
