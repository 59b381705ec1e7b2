"""Synthetic tests with known answers, and campaign folders written as plain text."""

import numpy as np
import pytest

from bayes_iwan.campaign import Record

# harmonics of the force in N, h = 0 ...; the fundamental leads the displacement's sine, so it dissipates
FORCE = np.array([0.3, 4 * np.exp(-1.2j), 0.1, 0.4 * np.exp(1j), 0, 0.05 * np.exp(-0.5j)])

TOML = """format = 1

[specimen]
name = "specimen"

[channels]
displacement = "displacement_mm"
force = "force_N"

[[test]]
file = "test.csv"
frequency_hz = 10.0
amplitude_mm = 1.0
"""


def series(coefficients, cycles):
    """Re sum_h c_h exp(2 pi i h cycles), written out as the definition says."""
    return sum((c * np.exp(2j * np.pi * h * cycles)).real for h, c in enumerate(coefficients))


def make_record(
    frequency_hz=10.0,
    amplitude_mm=1.0,
    rate_hz=1280.0,
    n_cycles=12.3,
    start=0.37,
    offset_mm=0.0,
    noise_mm=0.0,
    noise_N=0.0,
    force=FORCE,
    seed=0,
    time_s=None,
    file="test.csv",
    **stated,
):
    """A sine test whose force harmonics are known; `start` is the phase, in cycles, of time 0."""
    rng = np.random.default_rng(seed)
    if time_s is None:
        time_s = np.arange(int(n_cycles * rate_hz / frequency_hz)) / rate_hz
    cycles = frequency_hz * time_s + start
    u = offset_mm + amplitude_mm * np.sin(2 * np.pi * cycles) + noise_mm * rng.normal(size=time_s.size)
    f = series(force, cycles) + noise_N * rng.normal(size=time_s.size)
    nominal = {"frequency_hz": frequency_hz, "amplitude_mm": amplitude_mm, "role": "fit", "extras": {}} | stated
    return Record(file=file, time_s=time_s, displacement_mm=u, force_N=f, **nominal)


def csv_text(record, header="time_s,displacement_mm,force_N", digits=9):
    rows = zip(record.time_s, record.displacement_mm, record.force_N)
    return header + "\n" + "".join(f"{t:.{digits}g},{u:.{digits}g},{f:.{digits}g}\n" for t, u, f in rows)


@pytest.fixture
def force_harmonics():
    return FORCE.copy()


@pytest.fixture
def record():
    return make_record


@pytest.fixture
def csv():
    return csv_text


@pytest.fixture
def toml():
    return TOML


@pytest.fixture
def folder(tmp_path):
    """folder(toml, {file: text}) writes a campaign and returns its path; without arguments, a sound one."""

    def write(toml=TOML, files=None):
        (tmp_path / "campaign.toml").write_text(toml)
        for name, text in ({"test.csv": csv_text(make_record())} if files is None else files).items():
            (tmp_path / name).write_text(text)
        return tmp_path

    return write
