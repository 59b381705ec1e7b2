"""Does a simulator of the user's give a finite, real force wherever its prior leads, each draw by itself?"""

import warnings

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.inference.setup.problem import Problem
from bayes_iwan.models import ModelError

#: draws of the prior that are asked of it, and of these those that are also asked alone
DRAWS, ALONE = 200, 5


class NoForce(UserWarning):
    """A simulator that has no finite force in a part of its prior."""


def check_simulator(problem: Problem, seed: int = 0) -> None:
    """Ask the simulator for the force at draws of its prior.

    Raises ModelError, naming the parameter values: a motion that it changes, a force of another shape or of complex
    numbers, none that is finite anywhere, or one that depends on the other draws of the call. Warns NoForce where a
    part of the prior has none.
    """
    name = problem.model.name
    z = problem.prior.draw(np.random.default_rng([seed, 21]), DRAWS)
    force = _force(problem, z)
    finite = np.isfinite(force).all(axis=(1, 2))
    # draws without a force come first: alone they may have one
    for i in np.argsort(finite, kind="stable")[:ALONE]:
        alone = _force(problem, z[i : i + 1])[0]
        if not np.allclose(alone, force[i], rtol=1e-6, atol=1e-9 * problem.scales.force_N, equal_nan=True):
            raise ModelError(
                f"simulator {name}: the force at {_at(problem, z[i])} is {_size(force[i])} among other draws and "
                f"{_size(alone)} alone; `force` must treat every draw (the first axis) by itself"
            )
    if not finite.any():
        raise ModelError(
            f"simulator {name}: no draw of its prior has a finite force, for example {_at(problem, z[0])}; check "
            "`force` and the priors"
        )
    if not finite.all():
        bad = int(np.argmin(finite))
        warnings.warn(
            f"simulator {name}: no finite force in {100.0 * np.mean(~finite):.2g} % of its prior, for example at "
            f"{_at(problem, z[bad])}; these values are taken as impossible. Narrow the priors if that is not meant",
            NoForce,
            stacklevel=2,
        )


def _force(problem: Problem, z: Array) -> Array:
    """The simulator's own force (draws, tests, samples), checked for its shape and type."""
    values, name, motion = problem.parameter_values(z), problem.model.name, problem.motion
    given = (motion.displacement_mm, motion.velocity_m_s, motion.acceleration_m_s2)
    before = [x.copy() for x in given]
    with np.errstate(all="ignore"):
        force = np.asarray(problem.model.force(values, motion))
    if not all(np.array_equal(x, y, equal_nan=True) for x, y in zip(given, before)):
        raise ModelError(f"simulator {name}: `force` changes the motion's arrays, which all calls share; change a copy")
    expected = (len(z), problem.motion.loops, problem.motion.samples)
    if force.shape != expected:
        raise ModelError(
            f"simulator {name}: `force` returns shape {force.shape}, not (draws, tests, samples) {expected}"
        )
    if np.iscomplexobj(force):
        most = int(np.argmax(np.abs(force.imag).max(axis=(1, 2))))
        raise ModelError(
            f"simulator {name}: `force` returns complex numbers, for example at {_at(problem, z[most])}; return real "
            "ones, and NaN where there is no force"
        )
    return force


def _at(problem: Problem, z: Array) -> str:
    """The simulator's parameter values at z (ndim,), in words."""
    values, own = problem.prior.values(z[None]), {p.name for p in problem.model.parameters(problem.scales)}
    return ", ".join(f"{n} = {float(x[0]):.4g}" for n, x in values.items() if n in own)


def _size(force: Array) -> str:
    return f"{np.sqrt(np.mean(force**2)):.3g} N RMS" if np.isfinite(force).all() else "not a number"
