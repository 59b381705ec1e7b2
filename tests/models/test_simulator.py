"""What every simulator has, against plain NumPy and SciPy; and the priors of the built-in ones."""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from bayes_iwan.inference.setup import discrepancy, spectrum
from bayes_iwan.inference.setup.loop_scales import Scales
from bayes_iwan.models import Model, Reference, sine_motion, slip_force
from bayes_iwan.models.bouc_wen import OTHER_MODELS
from bayes_iwan.models.simulator import straight_part

TABLE = Path(__file__).with_name("priors.json")
SCALES = Scales(length_mm=0.9, speed_m_s=0.113, force_N=4.0, slip_N=1.2, soft_N_mm=5.5, stiff_N_mm=15.0)


def test_the_straight_part_is_numpys_fit_of_a_line_whatever_the_mean():
    rng = np.random.default_rng(4)
    u = 3.0 + np.sin(np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)) * np.array([[0.4], [1.7]])
    force = rng.normal(size=(3, 2, 64)) + 5.0 * u
    found = straight_part(force, u)
    for d, j in product(range(3), range(2)):
        np.testing.assert_allclose(found[d, j], np.polyval(np.polyfit(u[j], force[d, j], 1), u[j]), rtol=1e-9)


def table() -> dict[str, dict[str, list[float]]]:
    """By simulator and part of the likelihood: each prior's value one sd below, at and above its median, and ends."""
    reference = Reference(SCALES.length_mm, SCALES.speed_m_s)
    by_name = {f"slip {n}": Model(reference, slip=n).parameters(SCALES) for n in slip_force.FAMILIES}
    by_name |= {name: simulator.parameters(SCALES) for name, simulator in OTHER_MODELS.items()}
    by_name |= {f"spectrum {type(s).__name__}": s.parameters for s in (spectrum.Matern(), spectrum.OddEven())}
    by_name |= {"noise": (discrepancy.NOISE_SCALE,)}
    return {
        name: {p.name: [*p.value(np.array([-1.0, 0.0, 1.0])).tolist(), float(p.lower), float(p.upper)] for p in own}
        for name, own in by_name.items()
    }


@pytest.mark.parametrize("name", sorted(table()))
def test_priors_are_those_that_were_measured(name):
    """A changed prior changes every posterior. Where it is meant: `python -m tests.models.test_simulator`."""
    kept, now = json.loads(TABLE.read_text(encoding="utf-8")), table()
    assert sorted(kept) == sorted(now)
    assert sorted(kept[name]) == sorted(now[name])
    for key, values in kept[name].items():
        assert now[name][key] == pytest.approx(values, rel=1e-9), key


@pytest.mark.parametrize("name", (*slip_force.FAMILIES, *OTHER_MODELS))
def test_similar_specimens_have_similar_loops(name, kit):
    """Dynamic similarity: a specimen that is 1,000 times as strong, 10,000 times as long and 100 times as fast has the
    same loops in its own units, large and small."""
    loops = []
    for force, length, time in ((1.0, 1.0, 1.0), (1e3, 1e4, 1e-2)):
        scales = kit.scaled(force, length, time)
        simulator = OTHER_MODELS.get(name) or Model(scales.reference, slip=name, embedded=True)
        sampled = {p.name: p.value(np.array([0.7])) for p in simulator.parameters(scales)}
        at = sine_motion(frequency_hz=[20.0 / time, 8.0 / time], amplitude_mm=[0.9 * length, 0.01 * length])
        loops.append(simulator.force(simulator.parameter_values(sampled), at) / force)
    np.testing.assert_allclose(loops[1], loops[0], atol=1e-12)


@pytest.mark.parametrize("n", [2, 3])
def test_shares_of_components_are_uniform_on_all_ways_to_part_one(n):
    """Stick breaking by Beta(1, n − i) is Dirichlet(1, …, 1): each component's mean share is 1/n, and its second moment
    2/(n (n + 1))."""
    own = {p.name: p for p in Model(Reference(1.0, 0.1), slip=f"gamma{n}").parameters(SCALES)}
    z = np.random.default_rng(n).standard_normal((n - 1, 200_000))
    left, shares = np.ones(z.shape[1]), []
    for i in range(1, n):
        w = own[f"share_{i}"].value(z[i - 1])
        shares.append(left * w)
        left = left * (1.0 - w)
    for share in (*shares, left):
        assert share.mean() == pytest.approx(1.0 / n, rel=0.01)
        assert np.mean(share**2) == pytest.approx(2.0 / (n * (n + 1)), rel=0.02)


if __name__ == "__main__":
    TABLE.write_text(json.dumps(table(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
