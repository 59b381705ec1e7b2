"""`bayes-iwan export` and the results' own method: files, the card, and bad input in one line each."""

import errno
import importlib
import json
import os
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import bayes_iwan as bi
from bayes_iwan import files
from bayes_iwan.cli import main
from bayes_iwan.diagnosis.fits.discrepancy_size import DiscrepancySize
from bayes_iwan.effects.measuring_chain import ChannelDelay
from bayes_iwan.effects.specimen_forces import ViscousDamping
from bayes_iwan.export import TARGETS, ExportError, export, exporting
from bayes_iwan.inference.results.posterior import Posterior, Stop
from bayes_iwan.inference.results.predictions import ResidualSize
from bayes_iwan.inference.setup.problem import make_problem
from bayes_iwan.inference.setup.settings import ModelSettings
from bayes_iwan.models import Simulator

CLASSICAL = {"slip": "gamma1", "normal_force": "constant", "stiffness": "constant"}


@pytest.fixture(scope="module")
def posterior(made_up_campaign, few_quick_walkers):
    config = {"model": {**CLASSICAL, "embedded": False}}
    return bi.identify(made_up_campaign, quick=True, seed=1, progress=False, config=config)


@pytest.fixture(scope="module")
def run_folder(posterior, tmp_path_factory):
    from bayes_iwan.inference.results.run_files import write

    folder = tmp_path_factory.mktemp("run")
    write(posterior, folder)
    return folder


def test_the_command_writes_a_target_and_says_what_is_in_it(run_folder, tmp_path, capsys):
    assert main(["export", str(run_folder), "--to", "c", "--out", str(tmp_path), "--draws", "3"]) == 0
    said = capsys.readouterr().out
    assert "Tested" in said and "isolator.c" in said
    card = json.loads((tmp_path / "model_card.json").read_text())
    assert card["schema"] == 1 and card["draws"] == 3 and card["effects"] == {}
    assert card["frequency_hz"] == pytest.approx([10.0, 10.0], rel=1e-3)
    assert card["amplitude_mm"] == pytest.approx([0.3, 1.0], rel=1e-2)
    assert "force_zero" in card["omitted"]
    source = (tmp_path / "isolator.c").read_text()
    assert "#define ISOLATOR_SETS 4" in source and source.isascii()
    assert main(["export", str(run_folder), "--to", "json", "--out", str(tmp_path)]) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "isolator.json",
        "log.txt",
        "model_card.json",
        "model_card.txt",
    ]


def test_what_is_unexplained_is_the_gap_beyond_noise(posterior, monkeypatch):
    """As identify says it."""
    size = ResidualSize(rms_N=0.02, share=0.005, gap_N=0.01, gap_share=0.002)
    monkeypatch.setattr(Posterior, "residual_size", lambda self: size)
    assert exporting.source_of(posterior, 1, None, None).unexplained == (0.01, 0.002)


def test_without_draws_it_is_the_point_alone(posterior, tmp_path):
    posterior.export("json", tmp_path, draws=0)
    assert bi.load(tmp_path).values["kp_N_mm"].shape == (1,)


def test_a_run_that_did_not_converge_is_refused(posterior, tmp_path):
    unfinished = replace(posterior, converged=False, stop=Stop.BUDGET, message="R-hat 1.2 after 100 s")
    with pytest.raises(ExportError, match=r"has not converged \(R-hat 1.2 after 100 s\)"):
        unfinished.export("c", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_missing_compiler_is_one_line(posterior, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(ExportError, match="no C compiler; install one"):
        posterior.export("fmu", tmp_path / "out")
    monkeypatch.setenv("CC", str(tmp_path / "nothing"))
    with pytest.raises(ExportError, match=r"C compiler .*nothing failed on the FMU \(.*\); set CC to another"):
        posterior.export("fmu", tmp_path / "out")
    assert not (tmp_path / "out").exists()


class Spring(Simulator):
    name = "spring"

    def parameters(self, scales):
        from scipy import stats

        return (bi.Parameter("k_N_mm", "k", "N/mm", "stiffness", stats.lognorm(s=1.0, scale=scales.soft_N_mm)),)

    def force(self, parameter_values, motion, effects=()):
        return parameter_values["k_N_mm"][:, None, None] * motion.displacement_mm


def test_a_simulator_of_ones_own_cannot_be_written_in_c_but_its_draws_can(made_up_campaign, tmp_path, draws):
    problem = make_problem(bi.read_campaign(made_up_campaign).loops(), None, Spring())
    source = exporting.Source(
        problem=problem, z=draws(problem, 3), campaign=None, method="", seed=0, unexplained=(0.0, 0.0)
    )
    for target in TARGETS:
        if target == "json":
            files, card = exporting.files_of(source, "json", False, 1e-3)
            assert not re.search(r"nan|slip forces|Iwan|Step|Eq\. \(11\)", card.text())
            assert len(json.loads(files["isolator.json"])["parameters"][0]["draws"]) == 2
        else:
            with pytest.raises(ExportError, match="a simulator of your own, which cannot be written in C"):
                exporting.files_of(source, target, False, 1e-3)


@pytest.fixture
def fit(problem_of):
    """What a diagnosis holds of its fit with all named effects: viscous damping, and a delay of the channels."""
    problem = problem_of(normal_force="constant", stiffness="constant")
    effects = [kind(problem.scales) for kind in (ViscousDamping, ChannelDelay)]
    problem = problem.with_effects([replace(e, strength_value=e.first_guess()) for e in effects])
    z = np.zeros(problem.ndim)
    return SimpleNamespace(problem=problem, z=z, covariance=0.01 * np.eye(len(z)), effects=problem.effects)


def test_a_diagnosis_is_exported_with_its_named_effects(fit, tmp_path):
    after = SimpleNamespace(rms_N=0.03, share=0.01)
    found = SimpleNamespace(fit=fit, budget=SimpleNamespace(after=after), campaign=None, seed=1)
    export(found, "c", tmp_path, draws=2)
    card = json.loads((tmp_path / "model_card.json").read_text())
    assert set(card["effects"]) == {"viscous_damping"} and "channel_delay" in card["omitted"]
    assert card["unexplained_N"] == 0.03
    assert "viscous_damping_c_N_s_mm" in (tmp_path / "isolator.c").read_text()


def test_a_diagnosis_has_the_method(kit, tmp_path, monkeypatch):
    there = kit.diagnosed("viscous_damping", "held out")
    importlib.import_module("bayes_iwan.report.diagnosis.diagnosis_files")  # else it would keep the stand-in for ever
    monkeypatch.setattr("bayes_iwan.diagnosis.diagnosis.diagnose_campaign", lambda *args, **options: there)
    found = bi.diagnose("a campaign")
    found.export("json", tmp_path / "out", draws=1)
    assert bi.load(tmp_path / "out").values["kp_N_mm"].shape == (2,)


def test_the_folder_of_a_diagnosis_needs_its_campaign(fit, problem_of, tmp_path):
    saved_fits = pytest.importorskip("bayes_iwan.diagnosis.answer.saved_fits")
    size = DiscrepancySize(0.01, 1.0, 0.01, between=(1.0, 1.0, 0.5))
    fits = {frozenset({"viscous_damping", "channel_delay"}): SimpleNamespace(**vars(fit), size=size)}
    settings = bi.DiagnoseSettings(model=ModelSettings(normal_force="constant", stiffness="constant"))
    run_of, campaign = tmp_path / "run", tmp_path / "campaign"
    saved_fits.write_fits(run_of / "fits.json", fits, fit.problem.scales, settings, None, None)
    with pytest.raises(ExportError, match="name its campaign as well"):
        export(run_of, "json", tmp_path / "out")
    plan = [bi.PlannedTest(f, a, cycles=6) for f in (8.0, 20.0) for a in (0.4, 1.0)]
    bi.simulate_campaign(plan, seed=1).write(campaign)
    with pytest.raises(ExportError, match=r"diagnosis\.json: cannot be read \(.*; diagnose again"):
        export(run_of, "json", tmp_path / "out", draws=4, campaign=campaign)
    said = {"seed": 7, "gap": {"after_rms_N": 0.03, "after_share": 0.01}}
    (run_of / "diagnosis.json").write_text(json.dumps(said))
    export(run_of, "json", tmp_path / "out", draws=4, campaign=campaign)
    model = bi.load(tmp_path / "out")
    assert model.card["unexplained_N"] == 0.03 and model.card["seed"] == 7
    assert [e.name for e in model.effects] == ["viscous_damping"] and model.values["kp_N_mm"].shape == (5,)


def tree(folder):
    """Every file below a folder, hidden ones too, with its content."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture(scope="module")
def made(posterior):
    """Files of each target for two numbers of draws, as export makes them before it writes."""
    pytest.importorskip("fcntl")
    every = {}
    for to in TARGETS:
        for draws in (1, 2):
            try:
                every[to, draws] = exporting.files_of(exporting.source_of(posterior, draws, None, None), to, True, 1e-2)
            except ExportError as error:  # no compiler
                every[to, draws] = error
    return every


@pytest.mark.parametrize("to", TARGETS)
@pytest.mark.parametrize("how", ["disk full", "killed"])
def test_a_fault_half_way_leaves_the_former_export_or_none(to, how, made, posterior, tmp_path, monkeypatch):
    """At each file and each rename in turn: the disk is full, or the process is killed."""
    if isinstance(made[to, 1], ExportError):
        pytest.skip(str(made[to, 1]))
    monkeypatch.setattr(exporting, "files_of", lambda source, target, *_: made[target, len(source.z) - 1])
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("a user's own")
    (out / "mine").mkdir()
    (out / "mine" / "deeper.txt").write_text("a user's own")
    posterior.export(to, out, draws=1)
    former, calls = tree(tmp_path), 0
    posterior.export(to, tmp_path / "new", draws=2)
    after = {f"out/{n}": x for n, x in tree(tmp_path / "new").items()}
    shutil.rmtree(tmp_path / "new")

    def faulty(at):
        def wrap(real):
            def call(*args, **options):
                nonlocal calls
                calls += 1
                if calls == at:
                    if how == "killed":
                        os._exit(9)
                    raise OSError(errno.ENOSPC, "No space left on device", str(args[0]))
                return real(*args, **options)

            return call

        return wrap

    steps, states = len(made[to, 1][0]) + 2 + 2, set()  # files, two cards, two renames
    for at in range(1, steps + 1):
        calls = 0
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(exporting, "write_whole", faulty(at)(files.write_whole))
            patch.setattr(files.os, "rename", faulty(at)(os.rename))
            if how == "killed":
                if (child := os.fork()) == 0:
                    posterior.export(to, out, draws=2)
                    os._exit(0)
                assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
            else:
                with pytest.raises((OSError, ValueError), match=r"No space left on device"):
                    posterior.export(to, out, draws=2)
        left = tree(tmp_path)
        states.add("none" if not out.exists() else "former")
        if how == "disk full":
            assert left == former, f"step {at}"
        assert (
            not out.exists() or {n: x for n, x in left.items() if n.startswith("out/") and ".lock" not in n} == former
        )
        posterior.export(to, out, draws=1)
        assert tree(tmp_path).keys() == former.keys(), "the next export brings back what is not its own, and sweeps"
    assert states == ({"former"} if how == "disk full" else {"former", "none"})
    posterior.export(to, out, draws=2)
    kept = {n: former[n] for n in ("out/mine.txt", "out/mine/deeper.txt")}
    assert tree(tmp_path) == after | kept
