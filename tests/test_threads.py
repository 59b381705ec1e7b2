"""Work shared out over threads gives what one thread gives, in its order."""

from __future__ import annotations

import threading

import numba as nb
import numpy as np
import pytest

from bayes_iwan.threads import alongside


@pytest.fixture
def two_threads():
    if nb.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one thread only")
    before = nb.get_num_threads()
    nb.set_num_threads(2)
    yield
    nb.set_num_threads(before)


def test_pieces_run_side_by_side_each_on_one_thread(two_threads):
    together = threading.Barrier(2, timeout=60.0)  # passed only where two pieces run at a time

    def work(piece):
        together.wait()
        return piece**2, nb.get_num_threads()

    assert list(alongside(work, range(6))) == [(i**2, 1) for i in range(6)]
    assert nb.get_num_threads() == 2


def test_the_same_bits_on_one_thread_and_on_two(two_threads):
    matrices = [np.random.default_rng(i).standard_normal((120, 120)) for i in range(5)]
    found = list(alongside(np.linalg.inv, matrices))
    nb.set_num_threads(1)
    for a, b in zip(found, alongside(np.linalg.inv, matrices)):
        assert np.array_equal(a, b)


def test_what_a_piece_raises_is_raised(two_threads):
    def work(piece):
        if piece == 1:
            raise ValueError("no finite force")
        return piece

    with pytest.raises(ValueError, match="no finite force"):
        list(alongside(work, range(4)))
