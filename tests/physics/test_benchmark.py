"""Benchmarks of the forward model: `pytest tests/physics/test_benchmark.py --benchmark-enable`.

The whole comparison (limits of the machine, usual ways, errors) is `python analyses/benchmark_forward.py`.
"""

import numpy as np
import pytest

from bayes_iwan.physics import Model, sine_motion
from bayes_iwan.physics.bouc_wen import BoucWen

DRAWS = 64


@pytest.fixture
def motion():
    return sine_motion(frequency_hz=np.tile([10.0, 15.0, 20.0], 3), amplitude_mm=np.repeat([0.3, 0.6, 1.0], 3))


@pytest.mark.parametrize("slip", ["gamma3", "gamma1", "uniform"])
def test_force(slip, benchmark, motion, truth, reference):
    model = Model(reference, slip=slip)
    parameter_values = truth.table_1(reference, draws=DRAWS, spread=0.2)
    parameter_values |= {name: np.repeat(value, DRAWS) for name, value in truth.family_cases[slip][0].items()}
    force = benchmark(model.force, parameter_values, motion)
    assert force.shape == (DRAWS, 9, 128) and np.all(np.isfinite(force))


def test_bouc_wen(benchmark, motion, truth):
    parameter_values = truth.columns(
        kp_N_mm=5.0, force_zero_N=0.0, bw_k_N_mm=14.0, bw_force_N=1.2, bw_n=2.0, bw_share=0.6
    )
    parameter_values = {name: np.repeat(value, DRAWS) for name, value in parameter_values.items()}
    force = benchmark(BoucWen().force, parameter_values, motion)
    assert force.shape == (DRAWS, 9, 128) and np.all(np.isfinite(force))
