"""Table 1 of Rajaei, Ahmadian and Tavakoli: the parameter values of their rope spring."""

import numpy as np

from bayes_iwan.arrays import Array
from bayes_iwan.models.normal_force import Reference, from_paper_hunt_crossley
from bayes_iwan.models.stiffness import from_paper_stiffness

#: as printed: N/mm, N and mm; k̃ₙ in mm^−β, λ in s/m (with u̇ in m/s; in mm/s α would reach 180 at 10 Hz)
TABLE_1 = {
    "ki_N_mm": 19.62,
    "ku_N_mm": 30.37,
    "t_N": (0.24, 0.36, 0.50),
    "eta": (0.95, 5.1, 4.4),
    "g": (0.41, 0.53, 0.06),
    "kn_1_mm": 1.79,
    "lambda_s_m": 1.58,
    "beta": 0.0062,
    "kp_N_mm": 5.49,
}


def table_1(reference: Reference) -> dict[str, Array]:
    """Table 1 as parameter values (1,) of ``Model(reference)``, i.e. gamma3, hunt_crossley and saturating."""
    one = {name: np.atleast_1d(np.asarray(value, float)) for name, value in TABLE_1.items()}
    parameter_values = {"kp_N_mm": one["kp_N_mm"]}
    parameter_values |= from_paper_stiffness(one["ki_N_mm"], one["ku_N_mm"])
    for i in range(3):
        parameter_values |= {
            f"{symbol}{i + 1}{unit}": one[symbol + unit][i : i + 1]
            for symbol, unit in (("t", "_N"), ("eta", ""), ("g", ""))
        }
    return parameter_values | from_paper_hunt_crossley(one["kn_1_mm"], one["lambda_s_m"], one["beta"], reference)
