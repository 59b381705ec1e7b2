"""The public face: every name is there, results show themselves on one screen, a bad folder is refused before work."""

import ast
import csv
import importlib
import inspect
import json
import shutil
import subprocess
import sys
import warnings
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import bayes_iwan as bi
from bayes_iwan.cli import main
from bayes_iwan.errors import InputError
from bayes_iwan.inference.results.reach import extrapolated
from bayes_iwan.sampling.checkpoint import NAME

ONE = {"model": {"slip": "gamma1", "normal_force": "constant", "stiffness": "constant", "embedded": False}}


@pytest.fixture(scope="module", autouse=True)
def _words_alone(no_pictures, few_walkers):
    """For every page and run here."""


@pytest.fixture(scope="module")
def quick(made_up_campaign, tmp_path_factory, _words_alone):
    out = tmp_path_factory.mktemp("quick")
    return bi.identify(made_up_campaign, out, config=ONE, seed=1, quick=True, progress=False), out


def test_what_a_checker_sees_is_what_is_imported():
    """The stub's names are those handed out at run time, from the same modules."""
    seen = ast.parse(Path(bi.__file__).with_suffix(".pyi").read_text()).body
    declared = {a.name: f".{node.module}" for node in seen if isinstance(node, ast.ImportFrom) for a in node.names}
    (public,) = (ast.literal_eval(node.value) for node in seen if isinstance(node, ast.Assign))
    assert {*declared, "__version__"} == set(bi.__all__) == set(public) == set(dir(bi)) | {"__version__"}
    for name, module in declared.items():
        assert getattr(bi, name) is getattr(importlib.import_module(module, "bayes_iwan"), name)
    with pytest.raises(AttributeError, match="nothing_such"):
        getattr(bi, "nothing_such")  # noqa: B009


def sections(text):
    return {a.strip() for a, b in pairwise((text or "").splitlines()) if b.strip() and set(b.strip()) == {"-"}}


@pytest.mark.parametrize("name", sorted(set(bi.__all__) - {"__version__", "plot"}))
def test_what_is_handed_out_says_what_it_takes_and_shows_it(name):
    """numpydoc's sections; results are shown where they are made, errors need a sentence."""
    found = getattr(bi, name)
    there = sections(found.__doc__)
    if not isinstance(found, type):
        returns = set() if inspect.signature(found).return_annotation in ("None", None) else {"Returns"}
        wanted = {"Examples"} | returns
        wanted |= {"Parameters"} if inspect.signature(found).parameters else set()
        wanted |= {"Raises"} if name != "cite" else set()
    elif issubclass(found, Exception):
        wanted = set()
    else:
        assert there & {"Parameters", "Attributes"}
        wanted = {"Examples"} if name not in ("Comparison", "Diagnosis") else set()
    assert wanted <= there and len(found.__doc__.strip()) > 30


def test_check_shows_itself(made_up_campaign):
    found = bi.check(made_up_campaign)
    assert "f10_a1.csv" in repr(found) and "<pre>" in found._repr_html_() and len(found.loops) == 2


def test_quick_finds_the_numbers_that_made_the_loops_and_says_what_it_is(quick):
    posterior, out = quick
    rows = {r.name: r for r in posterior.summary()}
    for name, true in (("kp_N_mm", 5.5), ("k1_N_mm", 14.0), ("mean_slip_force_N", 1.2)):
        assert abs(rows[name].mean - true) < 4.0 * rows[name].sd and rows[name].sd < 0.2 * true
    with (out / "summary.csv").open() as file:
        table = {r["name"]: r for r in csv.DictReader(file)}
    for name, row in table.items():  # no diagnostics of a sampler, and every other number under its own name
        assert row["method"] == "quick" and row["ess_bulk"] == row["ess_tail"] == row["r_hat"] == ""
        assert float(row["q05"]) == pytest.approx(rows[name].q05, rel=1e-6)
    assert "Quick: the first draws" in (out / "report.html").read_text()
    assert posterior.quick and not posterior.converged
    again = bi.load(out)
    assert again.quick and np.array_equal(again.z, posterior.z)


def test_a_posterior_shows_predicts_and_hands_on_its_draws(quick):
    posterior, _ = quick
    shown = repr(posterior)
    assert len(shown) < 4000 and "kp_N_mm" in shown and "residual" in shown and "<pre>" in posterior._repr_html_()
    table = posterior.to_dataframe()
    assert table.shape[0] == posterior.flat_z().shape[0] and table.index.names == ["chain", "draw"]
    assert table["kp_N_mm"].mean() == pytest.approx(posterior.values()["kp_N_mm"].mean())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        data = posterior.to_arviz()
    assert float(np.asarray(data["posterior"]["kp_N_mm"]).mean()) == pytest.approx(table["kp_N_mm"].mean())
    found = posterior.predict(frequency_hz=10.0, amplitude_mm=[0.3, 1.0])
    low, middle, high = found.band()
    assert middle.shape == (2, 128) and np.all(low <= middle) and np.all(middle <= high)
    # the fitted tests, on their own nominal motion: measured loops lie where predicted
    measured = np.stack([x.force_N for x in posterior.loops])
    assert np.sqrt(np.mean((measured - middle) ** 2)) < 0.05
    assert posterior.residual_size().share < 0.03
    with pytest.raises(ValueError, match="there is no test"):
        posterior.plot.loop("nothing.csv")
    with pytest.raises(ValueError, match="did you mean 'kp_N_mm'"):
        posterior.interval("kp_N")
    for figure in (posterior.plot.loop("f10_a1.csv"), bi.plot.corner(posterior)):
        assert figure.axes


def test_what_is_printed_and_what_is_marked_come_from_all_draws(quick):
    """The same quantiles on one screen as in the table, and the same marks, whatever the point estimate is."""
    posterior, free = quick[0], quick[0].problem.prior.free
    z = np.random.default_rng(3).standard_normal((2, 3200, posterior.ndim))
    odd = np.array([p.score(np.array(1.5)) if p.name == "k1_N_mm" else 0.0 for p in free])
    posterior = replace(posterior, z=z, log_prob=z[..., 0], walkers=64, point=replace(posterior.point, z=odd))
    rows = {r.name: r for r in posterior.summary()}
    for p in free:
        row = rows[p.name]
        assert f"{row.q50:10.4g}  ({row.q05:.4g} to {row.q95:.4g})" in str(posterior._shown()), p.name
    marked = {name: row.reach for name, row in rows.items() if row.reach}
    assert "kp_N_mm" in marked and marked == extrapolated(posterior.problem, posterior.flat_z())
    assert f"kp_N_mm, k1_N_mm, mean_slip_force_N: {marked['kp_N_mm']}." in posterior.warnings()


def test_a_prior_that_excludes_the_truth_and_a_wrong_fixed_value_are_said(made_up_campaign, tmp_path, capsys):
    config = tmp_path / "c.toml"
    model = '[model]\nslip = "gamma1"\nnormal_force = "constant"\nstiffness = "constant"\nembedded = false\n'
    arguments = ["identify", str(made_up_campaign), "--quick", "--seed", "1", "--config", str(config)]
    config.write_text(model + "[parameters.kp_N_mm]\nupper = 3.0\n")
    assert main([*arguments, "--out", str(tmp_path / "cut")]) == 0
    said = capsys.readouterr().out
    assert "kp_N_mm lies at the upper end of its prior" in said and "residual" in said
    assert "lies at the upper end" in (tmp_path / "cut" / "report.html").read_text()
    wrong = ONE | {"parameters": {"k1_N_mm": {"fixed": 2.0}}}
    found = bi.identify(made_up_campaign, config=wrong, seed=1, quick=True, progress=False)
    assert any("misses the friction force by" in x for x in found.warnings())


def test_a_static_load_far_beyond_the_signal_moves_no_other_number(quick, made_up_campaign):
    """The mean force is solved for: 10 N and 10 kN beside 5 N of signal; 100 kN are beyond its prior, which is said."""
    sound = bi.read_campaign(made_up_campaign)
    rows, said = {0.0: {r.name: r for r in quick[0].summary()}}, {0.0: repr(quick[0])}
    for load in (10.0, 1e4, 1e5):
        tests = tuple(replace(r, force_N=r.force_N + load) for r in sound.tests)
        posterior = bi.identify(replace(sound, tests=tests), config=ONE, quick=True, seed=1, progress=False)
        rows[load], said[load] = {r.name: r for r in posterior.summary()}, repr(posterior)
    for load in (10.0, 1e4, 1e5):
        for name in ("kp_N_mm", "k1_N_mm", "mean_slip_force_N"):
            here, there = rows[load][name], rows[0.0][name]
            assert abs(here.mean - there.mean) < 0.3 * there.sd and here.sd < 1.3 * there.sd, (load, name)
        assert "force_zero_N lies at the upper end of its prior" in said[load]
        zero = rows[load]["force_zero_N"]
        assert load == 1e5 or abs(zero.mean - load) < 4.0 * zero.sd
    assert "upper end" not in said[0.0]


def test_out_is_looked_at_before_anything_is_computed(tmp_path, made_up_campaign, monkeypatch):
    def never(*a, **k):
        raise AssertionError("computed before the folder was looked at")

    monkeypatch.setattr("bayes_iwan.api.identify_campaign", never)
    file, held = tmp_path / "file", tmp_path / "held"
    file.write_text("")
    held.mkdir()
    (held / NAME).write_bytes(b"")
    for out, says in ((file, "is a file"), (file / "below", "is a file"), (held, "--resume"), ("/proc/none", "cannot")):
        with pytest.raises(ValueError, match=says) as caught:
            bi.identify(made_up_campaign, out)
        assert "\n" not in str(caught.value)


def test_an_error_of_the_disk_is_one_line(monkeypatch, capsys, tmp_path, made_up_campaign):
    def full(*a, **k):
        raise OSError(28, "No space left on device", "summary.csv")

    monkeypatch.setattr("bayes_iwan.api.identify_campaign", full)
    assert main(["identify", str(made_up_campaign), "--out", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr().err
    assert "summary.csv: No space left on device" in printed and printed.count("\n") == 1


def test_a_run_that_did_not_converge_warns(made_up_campaign):
    few = {"search": {"members": 40, "evaluations": 400, "second_search": False, "starts": 4}}
    few |= {"sampling": {"ensembles": 2, "walkers": 16, "max_steps": 40}, **ONE}
    with pytest.warns(bi.NotConverged, match="not converged: stopped at"):
        found = bi.identify(made_up_campaign, config=few, seed=1, progress=False)
    assert not found.converged and "have not converged" in repr(found)


DASHPOT = """
import numpy as np
from bayes_iwan import Effect


class Dashpot(Effect):
    name = "my_dashpot"
    strength = ("c_N_s_m", "c", "N·s/m", "force over speed")
    physics, reference, signature = "A dashpot.", "any textbook", "an ellipse beside the loop"

    def first_guess(self):
        return 0.1 * self.scales.slip_N / self.scales.speed_m_s

    def force(self, force_N, motion, parameter_values):
        return force_N + self.get(parameter_values, "c_N_s_m") * motion.velocity_m_s
"""


def test_effects_by_object_and_by_file_give_one_diagnosis(tmp_path):
    """One way in: what a file defines is what its classes are, and a campaign is its folder; results can be written."""
    plan = [bi.PlannedTest(f, a, cycles=6) for f in (8.0, 20.0) for a in (0.4, 0.9)]
    bi.simulate_campaign(plan, seed=2).write(tmp_path / "sound")
    file = tmp_path / "dashpot.py"
    file.write_text(DASHPOT)
    namespace: dict[str, object] = {"__name__": "in_a_notebook"}
    exec(DASHPOT, namespace)
    by_file = bi.diagnose(tmp_path / "sound", tmp_path / "file", effects=file, seed=1, quick=True, progress=False)
    read = bi.check(tmp_path / "sound").campaign
    by_class = bi.diagnose(
        read, tmp_path / "class", effects=[namespace["Dashpot"]], seed=1, quick=True, progress=False
    )  # fmt: skip
    assert by_file.verdict.probabilities == by_class.verdict.probabilities
    assert (tmp_path / "class" / "diagnosis.html").exists()
    stored = [json.loads((tmp_path / x / "fits.json").read_text())["effects_file"] for x in ("file", "class")]
    assert stored == ["../dashpot.py", None]
    for written in (x for x in (tmp_path / "file").rglob("*") if x.is_file()):
        assert str(tmp_path).encode() not in written.read_bytes(), written
    for options, said in (
        ({"base": "classical", "config": {}}, "config both"),
        ({"base": "rubber"}, "'rubber' is not known"),
    ):
        with pytest.raises(InputError, match=said):
            bi.diagnose(read, quick=True, **options)


def test_loops_are_identified_like_the_campaign_that_they_are_of(quick, made_up_campaign):
    loops = bi.check(made_up_campaign).campaign.loops(**asdict(quick[0].settings.loops))
    again = bi.identify_loops(loops, config=ONE, seed=1, quick=True, progress=False)
    np.testing.assert_array_equal(again.z, quick[0].z)


def test_a_simulator_of_ones_own_is_compared(made_up_campaign):
    file = Path(__file__).parents[1] / "analyses" / "simulators" / "dahl.py"
    short = {
        "search": {"members": 40, "evaluations": 400, "starts": 2, "second_search": False},
        "sampling": {"ensembles": 2, "budget_s": 1.0, "draws": 100},
    }
    found = bi.compare(made_up_campaign, families=["gamma1"], simulator=file, config=short, by="loo", progress=False)
    assert {row.name for row in found.rows()} == {"gamma1", "dahl"}


@pytest.mark.parametrize(
    ("mistake", "said"),
    [
        (lambda p, c: bi.diagnose(c, effects=["viscous_damping"]), "effects must be classes .* not 'viscous_damping'"),
        (lambda p, c: bi.diagnose(c, effects=5), "effects must be classes of your own"),
        (lambda p, c: bi.diagnose(c, seed=1.5), "seed must be a whole number"),
        (lambda p, c: bi.diagnose(None), "campaign must be one campaign"),
        (lambda p, c: bi.compare(c, families="gamma1"), "at least two families, not gamma1"),
        (lambda p, c: bi.compare(c, seed="a"), "seed must be a whole number"),
        (lambda p, c: bi.compare([c, c]), "campaign must be one campaign"),
        (lambda p, c: bi.identify(c, seed="a"), "seed must be a whole number, 0 to .* not 'a'"),
        (lambda p, c: bi.identify(c, seed=1.5), "seed must be a whole number, 0 to .* not 1.5"),
        (lambda p, c: bi.identify_problem(p.problem, -1), "seed must be a whole number, 0 to .* not -1"),
        (lambda p, c: bi.identify(None), "campaign must be one campaign"),
        (lambda p, c: bi.identify(5), "campaign must be one campaign"),
        (lambda p, c: bi.identify([c, c]), "campaign must be one campaign"),
        (lambda p, c: bi.identify(c, config=[1]), r"config must be a TOML file's path.* not \[1\]"),
        (lambda p, c: bi.identify(c, "out", quick=True, keep_chains=True), "keep_chains writes .* leave quick away"),
        (lambda p, c: bi.batch(c.parent, "out", quick=True, keep_chains=True), "leave quick or keep_chains"),
        (lambda p, c: bi.batch(None, "out"), "folder must be one path"),
        (lambda p, c: bi.batch(c.parent, "out", seed="a"), "seed must be a whole number"),
        (lambda p, c: bi.demo("out", seed=1.5), "seed must be a whole number"),
        (lambda p, c: bi.load(None), "folder must be one path"),
        (lambda p, c: p.interval("kp_N_mm", 90), "level must be between 0 and 1, such as 0.9 for 90 %, not 90"),
        (lambda p, c: p.interval("kp_N_mm", -1), "level must be between 0 and 1"),
        (lambda p, c: p.predict(10.0, 0.6).band(90), "level must be between 0 and 1"),
        (lambda p, c: p.predict(10.0, 0.6, n=0), "n must be a whole number, 1 or more, not 0"),
        (lambda p, c: p.predict(10.0, 0.6, samples=0), "samples must be a whole number, 8 or more, not 0"),
        (lambda p, c: p.predict(10.0, 0.6, samples=3), "samples must be a whole number, 8 or more, not 3"),
        (lambda p, c: bi.sine_motion(frequency_hz=0, amplitude_mm=1), "frequency_hz = 0: it must be a positive"),
        (lambda p, c: bi.plot.loops("results"), "not of a path; bi.load\\('results'\\) reads one"),
    ],
)
def test_a_wrong_argument_is_named_in_one_line(quick, made_up_campaign, tmp_path, monkeypatch, mistake, said):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(bi.InputError, match=said) as caught:
        mistake(quick[0], made_up_campaign)
    assert "\n" not in str(caught.value) and not list(tmp_path.iterdir())


def test_a_campaign_s_own_folder_takes_no_results(quick, made_up_campaign, capsys):
    before = sorted(made_up_campaign.iterdir())
    for write in (
        lambda: bi.identify(made_up_campaign, made_up_campaign, quick=True),
        lambda: bi.diagnose(made_up_campaign, made_up_campaign, quick=True),
        lambda: bi.compare(made_up_campaign, made_up_campaign),
        lambda: bi.write(quick[0], made_up_campaign),
        lambda: quick[0].export("json", made_up_campaign),
    ):
        with pytest.raises(bi.InputError, match="is a campaign's own folder, which takes no results"):
            write()
    assert main(["identify", str(made_up_campaign), "--out", str(made_up_campaign)]) == 2
    assert "takes no results" in capsys.readouterr().err and sorted(made_up_campaign.iterdir()) == before


def test_a_defect_of_ours_is_not_called_the_user_s_mistake(monkeypatch, capsys, made_up_campaign):
    def broken(*args, **options):
        return np.zeros(2) @ np.zeros(3)  # a ValueError of NumPy's

    monkeypatch.setattr("bayes_iwan.campaign.folders.check.read_checked", broken)
    assert main(["check", str(made_up_campaign)]) == 70
    said = capsys.readouterr().err
    assert "Traceback" in said and said.splitlines()[-1].startswith("bayes-iwan: ValueError: this is a defect of")


def test_an_option_of_before_is_refused_with_its_new_name():
    with pytest.raises(InputError, match='diagnose: the option executor is called "workers" now; rename it'):
        bi.diagnose("nowhere", executor=None)


def test_a_campaign_and_a_citation_show_themselves(made_up_campaign):
    """Short, without a path of this machine, and safe as HTML."""
    campaign = replace(bi.read_campaign(made_up_campaign), name="a<b", path=Path("/home/somebody/rig/specimen"))
    many = replace(campaign, tests=campaign.tests * 40)
    assert "specimen" in repr(campaign) and "/home" not in repr(campaign) and "f10_a1.csv" in repr(campaign)
    assert len(repr(many).splitlines()) == 24 and f"{len(many.tests) - 22} more, all in .tests" in repr(many)
    assert "a&lt;b" in campaign._repr_html_() and "a<b" not in campaign._repr_html_()
    cited = bi.cite()
    assert cited._repr_html_().count("<p>") == len(cited.splitlines()) and "emcee" in cited._repr_html_()


@pytest.mark.parametrize("kind", ["scales", "settings", "loop", "arrays"])
def test_reprs_fit_a_screen(kind):
    """What a notebook shows of a dataclass: lines of 100 characters at most, arrays by their shape."""
    from bayes_iwan.campaign.recording.records import Record
    from bayes_iwan.campaign.timing.cycles import cut_cycles
    from bayes_iwan.inference.setup.config import settings_of
    from bayes_iwan.models.scales import Scales

    t = np.arange(500) / 100
    made = {
        "scales": lambda: Scales(*np.random.default_rng(1).random(6)),
        "settings": settings_of,
        "loop": lambda: bi.campaign.average(
            Record("a.csv", 2.0, 1.0, "fit", {}, t, np.sin(12.6 * t), np.cos(12.6 * t))
        ),
        "arrays": lambda: cut_cycles("a", t, np.sin(12.6 * t)),
    }[kind]()
    lines = repr(made).splitlines()
    assert len(lines) < 40 and max(map(len, lines)) <= 100
    assert kind != "arrays" or "array of float64 (500,)" in repr(made)


def test_a_run_moved_with_its_campaign_loads_and_its_page_is_made_anew(quick, made_up_campaign, tmp_path):
    """As the two lay beside each other; a run moved alone says how to name its campaign."""
    posterior, out = quick
    for folder in (made_up_campaign, out):
        shutil.copytree(folder, tmp_path / "moved" / folder.relative_to(out.parent))
    run = tmp_path / "moved" / out.name
    (run / "report.html").unlink()
    assert main(["report", str(run)]) == 0 and "What is not known" in (run / "report.html").read_text()
    again = bi.load(run)
    np.testing.assert_array_equal(again.z, posterior.z)
    assert again.campaign.path == tmp_path / "moved" / made_up_campaign.name
    shutil.copytree(out, tmp_path / "alone" / "run")
    with pytest.raises(InputError, match=r"name the campaign's folder \(--campaign DIR\)"):
        bi.load(tmp_path / "alone" / "run")
    np.testing.assert_array_equal(bi.load(tmp_path / "alone" / "run", campaign=made_up_campaign).z, posterior.z)


def test_results_have_their_plots_whatever_name_was_asked_for_first():
    """In a process where nothing else has imported what registers them, not even for the name before."""
    code = """
import sys
for name in ("identify_loops", "identify_problem", "Posterior", "plot"):
    for module in [x for x in sys.modules if x.startswith("bayes_iwan")]:
        del sys.modules[module]
    import bayes_iwan
    getattr(bayes_iwan, name)
    from bayes_iwan.inference.results.posterior import Posterior
    assert hasattr(Posterior, "plot") and hasattr(Posterior, "export"), name
"""
    subprocess.run([sys.executable, "-c", code], check=True)
