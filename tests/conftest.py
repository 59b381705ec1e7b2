"""A campaign folder of a simple specimen, for whatever needs one."""

import os

import numba
import numpy as np
import pytest

from bayes_iwan.campaign import Record, write_campaign
from bayes_iwan.physics import Model, Reference, sine_motion


@pytest.fixture(scope="session")
def made_up_campaign(tmp_path_factory):
    """Two tests of a classical Iwan specimen with one gamma of slip forces, 8 cycles, noise of 0.02 N."""
    model = Model(Reference(1.0, 0.1), slip="gamma1", grip="constant", stiffness="constant")
    true = {"kp_N_mm": 5.5, "force_zero_N": 0.0, "k1_N_mm": 14.0, "t1_N": 0.6, "eta1": 2.0, "g1": 1.0}
    records = []
    for amplitude in (0.3, 1.0):
        loop = model.force({k: np.array([v]) for k, v in true.items()}, sine_motion(amplitude, 10.0))[0, 0]
        time = np.arange(8 * 128) / 1280.0
        noise = 0.02 * np.random.default_rng([7, int(10 * amplitude)]).standard_normal(time.size)
        records.append(Record(f"f10_a{amplitude:g}.csv", 10.0, amplitude, "fit", {}, time,
                              amplitude * np.sin(20.0 * np.pi * time), np.tile(loop, 8) + noise))
    folder = tmp_path_factory.mktemp("made_up")
    write_campaign(folder, name="made up", description="", tests=records, compress=False)
    return folder

# the analyses' scripts give their workers one thread through the environment; run inside this process they must not
# change the number that numba has started with
os.environ["NUMBA_NUM_THREADS"] = str(numba.config.NUMBA_NUM_THREADS)
