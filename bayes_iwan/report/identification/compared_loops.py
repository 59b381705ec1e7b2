"""What an isolator's designer reads off a loop, measured beside predicted, test by test."""

from dataclasses import dataclass

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.inference.results.posterior import Posterior
from bayes_iwan.inference.setup.loop_error import friction_rms_N
from bayes_iwan.inference.setup.quantities import loop_quantities
from bayes_iwan.models.motion import motion_of
from bayes_iwan.report.identification.loops import test_name
from bayes_iwan.report.identification.predictive import Predictive


@dataclass(frozen=True)
class Compared:
    """One quantity of a test: measured, predicted (value and interval of summary.csv), and the 90 % range in which
    a repeated measurement is expected."""

    measured: float
    q50: float
    q05: float
    q95: float
    repeat_q05: float
    repeat_q95: float


@dataclass(frozen=True)
class LoopRow:
    """One test, measured and predicted.

    residual_share : the RMS residual over the RMS friction force. energy_mJ, stiffness_N_mm, loss_factor : as in
    :class:`bayes_iwan.inference.setup.quantities.LoopQuantities`.
    """

    file: str
    test: str
    role: str
    rms_residual_N: float
    residual_share: float
    energy_mJ: Compared
    stiffness_N_mm: Compared
    loss_factor: Compared

    @property
    def held_out(self) -> bool:
        return self.role == "held-out"


def compared_loops(posterior: Posterior, p: Predictive) -> tuple[LoopRow, ...]:
    """Every test of a prediction, measured beside predicted."""
    measured, again = loop_quantities(p.displacement_mm, p.measured_N), loop_quantities(p.displacement_mm, p.loop_N)
    rms = np.std(p.residual_N(), axis=1)
    problem = posterior.problem
    friction = problem.friction_force(problem.parameter_values(posterior.flat_z(400)), motion_of(p.loops))
    share = rms / friction_rms_N(np.median(friction, axis=0), p.loops)

    def compared(name: str, seen: Array, repeated: Array, t: int) -> Compared:
        at = f"{name}[{p.loops[t].file}]"
        repeat = (float(q) for q in np.quantile(repeated[:, t], [0.05, 0.95]))
        return Compared(float(seen[t]), posterior.median(at), *posterior.interval(at), *repeat)

    return tuple(
        LoopRow(
            x.file,
            test_name(x, role=False),
            x.role,
            float(rms[t]),
            float(share[t]),
            compared("dissipated_energy_mJ", measured.energy_mJ, again.energy_mJ, t),
            compared("equivalent_stiffness_N_mm", measured.stiffness_N_mm, again.stiffness_N_mm, t),
            compared("loss_factor", measured.loss_factor, again.loss_factor, t),
        )
        for t, x in enumerate(p.loops)
    )
