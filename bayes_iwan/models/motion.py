"""Motion: what the specimen is made to do, as arrays shaped (1 or draws, loops, samples)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_iwan.arguments import positive, whole
from bayes_iwan.arrays import Array
from bayes_iwan.campaign import Loop
from bayes_iwan.campaign.loops.averaging import FEWEST_PER_CYCLE
from bayes_iwan.screen import on_screen

#: penetration y = max(A − u, Y_FLOOR·A): Eq. (11)'s |A − u|^β would vanish, or jump, at the end of the stroke
Y_FLOOR = 0.01
#: fewer points a cycle than a campaign may have do not show where a loop turns
LEAST_SAMPLES = int(FEWEST_PER_CYCLE)


@dataclass(frozen=True, kw_only=True)
@on_screen
class Motion:
    """What a specimen is made to do: loops (or one record), each of `samples` points; :func:`sine_motion` makes one.

    Parameters
    ----------
    displacement_mm, velocity_m_s, acceleration_m_s2
        (1 or draws, loops, samples), the displacement from its mean.
    frequency_hz, amplitude_mm
        (loops,); the loop's frequency, and A of Eq. (11) of Rajaei, Ahmadian & Tavakoli.
    cycle
        (loops,) cycle number at which the loop stands in its test, for effects that evolve.
    test
        (loops,) index of the test that a loop belongs to.
    periodic
        whether loops repeat themselves (else a record that starts from rest at u = 0).
    step_s
        (loops,) or (1,) between a record's samples; NaN where they are not uniform.
    span_cycles
        (loops,) or (1,) cycles of the record over which the loop is an average, about `cycle`.
    conditions
        what else was stated for the loop's test, by name, (loops,) each: ``pressure_bar`` and the like.

    Examples
    --------
    >>> import bayes_iwan as bi
    >>> motion = bi.sine_motion(frequency_hz=[10.0, 20.0], amplitude_mm=0.5)
    >>> motion.loops, motion.samples, round(float(motion.speed_m_s.max()), 4)  # 2π · 20 Hz · 0.5 mm
    (2, 128, 0.0628)
    """

    displacement_mm: Array
    velocity_m_s: Array
    acceleration_m_s2: Array
    frequency_hz: Array
    amplitude_mm: Array
    cycle: Array
    test: NDArray[np.int64]
    periodic: bool = True
    step_s: Array = field(default_factory=lambda: np.full(1, np.nan))
    span_cycles: Array = field(default_factory=lambda: np.ones(1))
    conditions: Mapping[str, Array] = field(default_factory=dict)

    @property
    def draws(self) -> int:
        """How many motions for each loop: 1 where all draws share one."""
        return self.displacement_mm.shape[0]

    @property
    def loops(self) -> int:
        """How many loops."""
        return self.displacement_mm.shape[1]

    @property
    def samples(self) -> int:
        """Samples of each."""
        return self.displacement_mm.shape[2]

    @cached_property
    def log_penetration(self) -> Array:
        """ln y, y = max(A − u, 0.01 A) in mm: a constant of the data, like |u̇|, so taken once."""
        a = self.amplitude_mm[:, None]
        return np.log(np.maximum(a - self.displacement_mm, Y_FLOOR * a))

    @cached_property
    def speed_m_s(self) -> Array:
        """|u̇|, shaped as the velocity."""
        return np.abs(self.velocity_m_s)

    @cached_property
    def slope_mm(self) -> Array:
        """Slope of the displacement in mm a sample, shaped as it; NaN where the samples may lie anywhere."""
        per_sample = (
            1e3 / (self.frequency_hz * self.samples) if self.periodic else np.full(self.loops, 1e3 * self.step_s)
        )
        slope = self.velocity_m_s * per_sample[:, None]
        # a copy: kernels are compiled once more for arrays that may not be written to, as broadcast ones
        return np.array(np.broadcast_to(slope, self.displacement_mm.shape), order="C")

    def of_draws(self, part: slice | NDArray[np.bool_]) -> Motion:
        """The motion of some draws only; itself where all draws share one motion."""
        if self.draws == 1:
            return self
        return self.moved(self.displacement_mm[part], self.velocity_m_s[part], self.acceleration_m_s2[part])

    def moved(self, displacement_mm: Array, velocity_m_s: Array, acceleration_m_s2: Array) -> Motion:
        """The same tests with another specimen motion, draw by draw."""
        return replace(
            self, displacement_mm=displacement_mm, velocity_m_s=velocity_m_s, acceleration_m_s2=acceleration_m_s2
        )


def sine_motion(*, frequency_hz: ArrayLike, amplitude_mm: ArrayLike, samples: int = 128) -> Motion:
    """Steady sines, `samples` points a cycle.

    Parameters
    ----------
    frequency_hz, amplitude_mm
        scalars or (loops,), one loop a pair; named, since both are plain numbers and an
        exchanged pair would still give a motion.
    samples
        points a cycle, 8 or more.

    Returns
    -------
    Motion
        u = A sin ωt with its velocity and acceleration, (1, loops, samples).

    Raises
    ------
    InputError
        a frequency or amplitude that is not positive, too few samples.

    Examples
    --------
    >>> import bayes_iwan as bi
    >>> motion = bi.sine_motion(frequency_hz=[10.0, 20.0], amplitude_mm=0.5, samples=64)
    >>> motion.displacement_mm.shape, float(motion.displacement_mm.max())
    ((1, 2, 64), 0.5)
    """
    samples = whole(samples, "samples", LEAST_SAMPLES)
    a, f = np.broadcast_arrays(
        np.atleast_1d(positive(amplitude_mm, "amplitude_mm")), positive(frequency_hz, "frequency_hz")
    )
    phase = 2.0 * np.pi * np.arange(samples) / samples
    omega = 2.0 * np.pi * f[:, None]
    u = a[:, None] * np.sin(phase)
    return Motion(
        displacement_mm=u[None],
        velocity_m_s=(1e-3 * omega * a[:, None] * np.cos(phase))[None],
        acceleration_m_s2=(-1e-3 * omega**2 * u)[None],
        frequency_hz=f.astype(float),
        amplitude_mm=a.astype(float),
        cycle=np.zeros(len(a)),
        test=np.arange(len(a)),
    )


def record_motion(
    time_s: Array, displacement_mm: Array, *, frequency_hz: float = float("nan"), amplitude_mm: float | None = None
) -> Motion:
    """A motion (n,) from rest at u = 0; velocity by central differences. amplitude_mm is A of Eq. (11)."""
    u, t = np.asarray(displacement_mm, float), np.asarray(time_s, float)
    v = 1e-3 * np.gradient(u, t)
    a = float(np.max(np.abs(u))) if amplitude_mm is None else amplitude_mm
    steps = np.diff(t)
    step_s = steps[0] if np.allclose(steps, steps[0], rtol=1e-6, atol=0.0) else np.nan
    return Motion(
        displacement_mm=u[None, None],
        velocity_m_s=v[None, None],
        acceleration_m_s2=np.gradient(v, t)[None, None],
        frequency_hz=np.array([frequency_hz]),
        amplitude_mm=np.array([a]),
        cycle=np.zeros(1),
        test=np.zeros(1, dtype=np.int64),
        periodic=False,
        step_s=np.array([step_s]),
    )


def motion_of(loops: Sequence[Loop], blocks: bool = False) -> Motion:
    """The loops' motion, one model loop each, or with `blocks` one for each block of cycles of each."""
    repeat = np.array([len(x.block_cycle) if blocks else 1 for x in loops])

    u, v, a = (
        np.repeat(np.stack([getattr(x, name) for x in loops]), repeat, axis=0)[None]
        for name in ("displacement_mm", "velocity_m_s", "acceleration_m_s2")
    )

    cycle = np.concatenate([x.block_cycle if blocks else [x.block_cycle.mean()] for x in loops])
    stated = [name for name in loops[0].extras if all(name in x.extras for x in loops)]
    return Motion(
        displacement_mm=u,
        velocity_m_s=v,
        acceleration_m_s2=a,
        cycle=np.asarray(cycle, float),
        frequency_hz=np.repeat([x.frequency_hz for x in loops], repeat),
        amplitude_mm=np.repeat([x.amplitude_mm for x in loops], repeat),
        test=np.repeat(np.arange(len(loops)), repeat),
        span_cycles=np.repeat([x.n_cycles for x in loops] / repeat, repeat),
        conditions={name: np.repeat([float(x.extras[name]) for x in loops], repeat) for name in stated},
    )
