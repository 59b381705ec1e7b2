"""Benchmarks of the forward model: `pytest tests/models/test_benchmark.py --benchmark-enable`.

The whole comparison (limits of the machine, usual ways, errors) is `python analyses/benchmark_forward.py`, whose parts
run here at a few draws.
"""

import numba as nb
import numpy as np
import pytest

import benchmark_forward
from bayes_iwan.models import Model, sine_motion
from bayes_iwan.models.bouc_wen import BoucWen

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


@pytest.fixture
def _threads_as_before():
    threads = nb.get_num_threads()
    yield
    nb.set_num_threads(threads)


@pytest.mark.usefixtures("_threads_as_before")
def test_the_comparison_runs_and_reports():
    """Every part of the script at two draws: elements agree with the sliders as closely as their number lets them."""
    result = benchmark_forward.run(draws=2, repeats=1, exact=4000)
    error = result["error"]
    assert error["4000"] < error["2000"] < error["128"] < 0.02 and error["4000"] < 1e-3
    assert min(result["stage_ns"].values()) > 0.0 and min(result["usual_ways"].values()) > 0.0
    text = benchmark_forward.report(result | {"cold_start_s": 1.0})
    assert "numpy elements,   4000 (equal accuracy)" in text


def test_plain_numpy_gives_the_same_force(reference):
    """The usual way that the script times is the same model: it differs by what lies between its samples only."""
    model, parameter_values = Model(reference), benchmark_forward.scattered(2, reference)
    motion = sine_motion(frequency_hz=[10.0, 20.0], amplitude_mm=[0.3, 1.0], samples=benchmark_forward.SAMPLES)
    force = model.force(parameter_values, motion)
    plain = benchmark_forward.numpy_elements(model, parameter_values, motion, 3000)
    assert np.sqrt(np.mean((plain - force) ** 2) / np.mean(force**2)) < 2e-3
