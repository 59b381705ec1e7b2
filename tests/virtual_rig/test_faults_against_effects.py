"""The rig's faults and the diagnosis' effects, made apart, held against each other: names, main numbers, and what a
number does to the force."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_iwan.campaign import Campaign
from bayes_iwan.diagnosis.fits.data import gap_data, predicted
from bayes_iwan.diagnosis.fits.evidence import base_problem, fit_model
from bayes_iwan.effects import catalogue
from bayes_iwan.inference.setup.loop_scales import scales_of
from bayes_iwan.inference.setup.settings import DiagnoseSettings
from bayes_iwan.virtual_rig.faults import CATALOGUE, KINDS
from bayes_iwan.virtual_rig.simulate import PlannedTest, Setup, VirtualRig, records
from bayes_iwan.virtual_rig.sizing import size_fault
from bayes_iwan.virtual_rig.specimen import paper_specimen

PLAN = tuple(PlannedTest(f, a, cycles=24, run_in=6) for f in (8.0, 17.0) for a in (0.4, 0.9))
SETUP = Setup(frequency_error=0.0, amplitude_error=0.0, wander=0.0)
SIZES = {"normal_force_lag": 0.02}
#: a number of the effect from the main number of the fault, where it is not the same one
STRENGTH = {"force_lowpass": lambda corner: 1 / (2 * np.pi * corner), "force_clipping": lambda limit: 1 / limit}
#: an effect's law is a family: the extra parameters at which it is the law that the rig has too
CLASSICAL = {
    "end_stop.exponent": 1.0,
    "end_stop.loss_s_m": 0.0,
    "force_lowpass.second": 0.0,
    "force_clipping.softness": 2e-3,
    "maxwell_branch.spread": 0.999,
    "viscous_damping.exponent": 1.0,
    "moving_mass.period_s": 0.0,
}


@pytest.fixture(scope="module")
def sound():
    """A specimen that the base model can be, its loops, and the base model fitted to them."""
    specimen = paper_specimen(240)
    loops = loops_of(specimen, ())
    data, scales = gap_data(loops), scales_of(loops)
    problem = base_problem(data, DiagnoseSettings(), scales)
    return specimen, data, scales, fit_model(data, problem, np.zeros((1, problem.ndim)), iterations=25)


def loops_of(specimen, faults):
    runs = VirtualRig(specimen, SETUP, faults).run_all(PLAN, clean=True)
    rng = np.random.default_rng(0)  # a little noise: none at all has no weight
    tests = tuple(replace(r, force_N=r.force_N + 2e-3 * rng.standard_normal(r.force_N.size)) for r in records(runs))
    campaign = Campaign("virtual rig", "", "", "", None, tests)
    return campaign.loops(n_phase=80, n_harmonics=24)


def column(data, harmonics, trend, lines):
    """All that is compared, as one complex vector: resolved harmonics, contrasts between blocks, lines of the mains."""
    shown = np.stack([np.isfinite(x.noise_N) for x in data.loops])
    trend = np.zeros_like(data.trend_N) if trend is None else np.where(np.isfinite(data.trend_noise_N), trend, 0.0)
    lines = np.zeros_like(data.mains_N) if lines is None else lines
    return np.concatenate([np.ravel(x) for x in (np.where(shown, harmonics, 0.0), trend, lines)])


def predictions(data, problem, z):
    return column(data, *(None if x is None else x[0] for x in predicted(data, problem, z[None])))


def test_same_names_and_same_main_numbers():
    effects = catalogue.variants()
    assert {*CATALOGUE, *(e.name for e in catalogue.FORM)} == set(effects)
    for name in CATALOGUE:
        strength = {kind.strength[0] for kind in effects[name]}
        assert KINDS[name].main in strength or name in STRENGTH, name


@pytest.mark.parametrize("name", CATALOGUE)
def test_one_number_moves_the_force_alike(sound, name):
    """The shared law: the change of the rig's loops, and the change that the effect predicts at the rig's numbers."""
    specimen, data, _, _ = sound
    fault = size_fault(name, SIZES.get(name, 0.08), VirtualRig(specimen, SETUP), PLAN, np.random.default_rng(2))
    assert fault.law == KINDS[name].laws[0].name
    faulty = gap_data(loops_of(specimen, (fault,)))
    changes = (getattr(faulty, x) - getattr(data, x) for x in ("harmonics_N", "trend_N", "mains_N"))
    rig = column(data, *changes)
    alike = [compared(kind, fault, sound, faulty, rig) for kind in catalogue.variants()[name]]
    cosine, ratio = max(alike)
    assert cosine > 0.98 and 0.95 < ratio < 1.06, alike


def compared(kind, fault, sound, faulty, rig):
    """Cosine and ratio of the change that a variant of the effect predicts to the change on the rig."""
    _, data, scales, base = sound
    main = STRENGTH.get(fault.name, float)(fault.parameters[KINDS[fault.name].main])
    effect = kind(scales, tuple(x.file for x in faulty.loops), abs(main))
    problem = base_problem(faulty, DiagnoseSettings(), scales).with_effects((effect,))
    values = {f"{fault.name}.{own}": v for own, v in fault.parameters.items()} | {effect.strength_name: main}
    values |= CLASSICAL | mains_by_test(fault, faulty)
    z = np.zeros(problem.ndim)
    for i, p in enumerate(problem.prior.free):
        if p.name in base.problem.names:
            z[i] = base.z[base.problem.names.index(p.name)]
        elif p.name in values:
            z[i] = p.score(np.array(values[p.name]))
    model = predictions(faulty, problem, z) - predictions(data, base.problem, base.z)
    lengths = np.linalg.norm(rig), np.linalg.norm(model)
    return float(np.vdot(rig, model).real / (lengths[0] * lengths[1])), float(lengths[1] / lengths[0])


def mains_by_test(fault, faulty):
    """The mains' phase differs from record to record: it is taken from the records, the amplitude from the fault."""
    if fault.name != "mains_interference":
        return {}
    line = [50.0, 60.0].index(fault.parameters["frequency_hz"])
    turned = fault.parameters["amplitude_N"] * np.exp(1j * np.angle(faulty.mains_N[:, line]))
    files = [x.file for x in faulty.loops]
    return {f"mains_interference.cosine[{f}]": x.real for f, x in zip(files, turned)} | {
        f"mains_interference.sine[{f}]": x.imag for f, x in zip(files, turned)
    }
