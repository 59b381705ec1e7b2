"""What laws of faults are made of: how their parameters are drawn, and what these do."""

from collections.abc import Callable
from typing import Any

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.virtual_rig.fault import Acting, Acts, Draw, Parameters, Surroundings
from bayes_iwan.virtual_rig.kernel import FaultValues
from bayes_iwan.virtual_rig.sensors import Chain


def uniform(over: str = "", /, **ranges: tuple[float, float]) -> Draw:
    """Draws parameters between two ends each, shares of what `over` names of the surroundings, if it names any."""

    def draw(rng: np.random.Generator, s: Surroundings) -> Parameters:
        whole = getattr(s, over) if over else 1.0
        return {name: float(rng.uniform(*ends)) * whole for name, ends in ranges.items()}

    return draw


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def linear(ceiling: Callable[[Surroundings], float]) -> Callable[[Surroundings, float], float]:
    """A main parameter in proportion to the strength."""
    return lambda s, strength: ceiling(s) * strength


def _of(p: Parameters, names: dict[str, str]) -> dict[str, Any]:
    return {what: p[name] for what, name in names.items()}


def moving(**names: str) -> Acts:
    """Values of the kernel by the names of the parameters that they are."""
    return lambda p: Acting(motion=FaultValues(**_of(p, names)))


def measuring(**names: str) -> Acts:
    """Settings of the measuring chain by the names of the parameters that they are."""
    return lambda p: Acting(chain=Chain(**_of(p, names)))


def spring(force_N: Callable[[Array, Parameters], Array]) -> Acts:
    """A force over the specimen's deformation (mm)."""
    return lambda p: Acting(displacement_force=lambda d: force_N(d, p))


def damper(force_N: Callable[[Array, Parameters], Array]) -> Acts:
    """A force over its speed (mm/s)."""
    return lambda p: Acting(speed_force=lambda v: force_N(v, p))


def slip_speed(factor: Callable[[Array, Parameters], Array]) -> Acts:
    """A factor on a slip force over its remembered slip speed (mm/s)."""
    return lambda p: Acting(rate_factor=lambda w: factor(w, p))
