"""Motion: what the specimen is made to do, as arrays shaped (1 or draws, loops, samples)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop

#: penetration y = max(A − u, Y_FLOOR·A): Eq. (11)'s |A − u|^β would vanish, or jump, at the end of the stroke
Y_FLOOR = 0.01


@dataclass(frozen=True)
class Motion:
    """Motion of `loops` loops (or one record), each `samples` long.

    displacement_mm, velocity_m_s, acceleration_m_s2 : (1 or draws, loops, samples), measured from its mean
    amplitude_mm, frequency_hz : (loops,); A of Eq. (11) and the loop's frequency
    cycle : (loops,) cycle number at which the loop stands in its test, for effects that evolve
    test : (loops,) index of the test that a loop belongs to
    span_cycles : (loops,) or (1,) cycles of the record over which the loop is an average, about `cycle`
    conditions : what else was stated for the loop's test, by name, (loops,) each: ``pressure_bar`` and the like
    periodic : loops repeat themselves (else a record that starts from rest at u = 0)
    """

    displacement_mm: Array
    velocity_m_s: Array
    acceleration_m_s2: Array
    amplitude_mm: Array
    frequency_hz: Array
    cycle: Array
    test: NDArray[np.int64]
    periodic: bool = True
    span_cycles: Array = field(default_factory=lambda: np.ones(1))
    conditions: Mapping[str, Array] = field(default_factory=dict)

    @property
    def loops(self) -> int:
        return self.displacement_mm.shape[1]

    @property
    def samples(self) -> int:
        return self.displacement_mm.shape[2]

    @cached_property
    def log_penetration(self) -> Array:
        """ln y, y = max(A − u, 0.01 A) in mm: a constant of the data, like |u̇|, so taken once."""
        a = self.amplitude_mm[:, None]
        return np.log(np.maximum(a - self.displacement_mm, Y_FLOOR * a))

    @cached_property
    def speed_m_s(self) -> Array:
        return np.abs(self.velocity_m_s)

    def of_draws(self, part: slice) -> Motion:
        """The motion of some draws only; itself where all draws share one motion."""
        if self.displacement_mm.shape[0] == 1:
            return self
        return self.moved(self.displacement_mm[part], self.velocity_m_s[part], self.acceleration_m_s2[part])

    def moved(self, displacement_mm: Array, velocity_m_s: Array, acceleration_m_s2: Array) -> Motion:
        """The same tests with another specimen motion, draw by draw."""
        return replace(
            self,
            displacement_mm=displacement_mm,
            velocity_m_s=velocity_m_s,
            acceleration_m_s2=acceleration_m_s2,
        )


def sine_motion(amplitude_mm, frequency_hz, samples: int = 128) -> Motion:
    """Steady sines, one loop for each pair of amplitude (mm) and frequency (Hz), `samples` points a cycle."""
    a, f = np.broadcast_arrays(np.atleast_1d(np.asarray(amplitude_mm, float)), np.asarray(frequency_hz, float))
    phase = 2.0 * np.pi * np.arange(samples) / samples
    omega = 2.0 * np.pi * f[:, None]
    u = a[:, None] * np.sin(phase)
    return Motion(
        u[None],
        (1e-3 * omega * a[:, None] * np.cos(phase))[None],
        (-1e-3 * omega**2 * u)[None],
        a.astype(float),
        f.astype(float),
        np.zeros(len(a)),
        np.arange(len(a)),
    )


def record_motion(
    time_s: Array, displacement_mm: Array, amplitude_mm: float | None = None, frequency_hz: float = float("nan")
) -> Motion:
    """Any motion (n,) from rest at u = 0; velocity by central differences. amplitude_mm is A of Eq. (11)."""
    u = np.asarray(displacement_mm, float)
    t = np.asarray(time_s, float)
    v = 1e-3 * np.gradient(u, t)
    a = float(np.max(np.abs(u))) if amplitude_mm is None else amplitude_mm
    return Motion(
        u[None, None],
        v[None, None],
        np.gradient(v, t)[None, None],
        np.array([a]),
        np.array([frequency_hz]),
        np.zeros(1),
        np.zeros(1, dtype=np.int64),
        periodic=False,
    )


def motion_of(loops: Sequence[Loop], blocks: bool = False) -> Motion:
    """The loops' motion, one model loop each, or with `blocks` one for each block of cycles of each."""
    repeat = np.array([len(x.block_cycle) if blocks else 1 for x in loops])

    def stacked(name: str) -> Array:
        return np.repeat(np.stack([getattr(x, name) for x in loops]), repeat, axis=0)[None]

    cycle = np.concatenate([x.block_cycle if blocks else [x.block_cycle.mean()] for x in loops])
    stated = [name for name in loops[0].extras if all(name in x.extras for x in loops)]
    return Motion(
        stacked("displacement_mm"),
        stacked("velocity_m_s"),
        stacked("acceleration_m_s2"),
        np.repeat([x.amplitude_mm for x in loops], repeat),
        np.repeat([x.frequency_hz for x in loops], repeat),
        np.asarray(cycle, float),
        np.repeat(np.arange(len(loops)), repeat),
        span_cycles=np.repeat([x.n_cycles for x in loops] / repeat, repeat),
        conditions={name: np.repeat([float(x.extras[name]) for x in loops], repeat) for name in stated},
    )
