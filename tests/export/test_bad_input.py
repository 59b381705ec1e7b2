"""Whatever is wrong, in any target: one line that says what, and the folder as it was."""

import json
import os
import shutil
from pathlib import Path

import h5py
import pytest

import bayes_iwan as bi
from bayes_iwan.cli import main
from bayes_iwan.export import TARGETS
from bayes_iwan.inference.results import run_files

EFFECT = Path(__file__).parents[2] / "analyses" / "effects" / "quadratic_drag.py"
SPRING = """import bayes_iwan as bi
from scipy import stats
class Spring(bi.Simulator):
    name = "spring"
    def parameters(self, scales):
        return (bi.Parameter("k_N_mm", "k", "N/mm", "stiffness", stats.lognorm(s=1.0, scale=scales.soft_N_mm)),)
    def force(self, parameter_values, motion, effects=()):
        return parameter_values["k_N_mm"][:, None, None] * motion.displacement_mm
"""


@pytest.fixture(scope="module")
def here(made_up_campaign, few_quick_walkers, no_pictures, tmp_path_factory):
    """Runs of every kind: finished, unfinished, damaged, of another version, a diagnosis, a user's own simulator."""
    top = tmp_path_factory.mktemp("here")
    parts = {"slip": "gamma1", "normal_force": "constant", "stiffness": "constant"}
    config = {"model": {**parts, "embedded": False}}
    found = bi.identify(made_up_campaign, quick=True, seed=1, progress=False, config=config)
    run_files.write(found, top / "run")
    for name in ("Lauf mit Umläuten ß", "damaged", "empty", "other"):
        shutil.copytree(top / "run", top / name)
    whole = (top / "run" / "posterior.nc").read_bytes()
    (top / "damaged" / "posterior.nc").write_bytes(whole[: len(whole) // 2])
    (top / "empty" / "posterior.nc").write_bytes(b"")
    with h5py.File(top / "other" / "posterior.nc", "r+") as file:
        file.attrs["format"] = 99
    (top / "unfinished").mkdir()
    (top / "unfinished" / "chains.ckpt").write_bytes(b"begun")
    (top / "file").write_text("")
    (top / "spring.py").write_text(SPRING)
    own = bi.identify(made_up_campaign, quick=True, seed=1, progress=False, simulator=top / "spring.py")
    run_files.write(own, top / "own")
    for name, schema in (("diagnosis", 5), ("older", 1)):
        (top / name).mkdir()
        (top / name / "fits.json").write_text(json.dumps({"schema": schema}))
    bi.diagnose(made_up_campaign, top / "effects", quick=True, effects=EFFECT, config={"model": parts})
    return top


CASES = {
    "a file of that name": ("run", {"out": "file"}, "there is a file of this name"),
    "below a file": ("run", {"out": "file/x"}, "there is a file of this name"),
    "no folder": ("run", {"out": ""}, "is the folder you are in, which cannot be replaced; name one inside it"),
    "cannot be made": ("run", {"out": "/proc/none/x"}, "cannot be made"),
    "a list": ("run", {"to": "c,fmu"}, "'c,fmu' is no target; did you mean 'fmu'"),
    "another's name": ("run", {"to": "simulink"}, "'simulink' is no target"),
    "nearly a name": ("run", {"to": "fmuu"}, "did you mean 'fmu'?"),
    "fewer than none": ("run", {"draws": "-1"}, "draws must be 0 or more, not -1"),
    "more than there are": ("run", {"draws": "99999"}, "draws can be 1600 at most, not 99999"),
    "unfinished": ("unfinished", {}, "no finished run there"),
    "nothing there": ("nowhere", {}, "no finished run there"),
    "a file as run": ("file", {}, "no finished run there"),
    "half a file": ("damaged", {}, "damaged, or not a result of this version"),
    "an empty file": ("empty", {}, "damaged, or not a result of this version"),
    "another version": ("other", {}, "version"),
    "another campaign": ("run", {"campaign": "nowhere"}, "its campaign is not in"),
    "a diagnosis alone": ("diagnosis", {}, "name its campaign as well (--campaign DIR)"),
    "a diagnosis half written": ("diagnosis", {"campaign": "made_up"}, "damaged"),
    "a diagnosis of an older version": ("older", {"campaign": "made_up"}, "version"),
    "an effect without a law in time": ("effects", {"campaign": "made_up"}, "which has no law in C to export"),
    "own simulator": ("own", {}, "name it (--simulator FILE"),
}


#: what is found by the target itself, and something of each kind that is found before: all else is asked of one target
BY_EACH = ("below a file", "nearly a name", "more than there are", "half a file")
BY_EACH += ("an effect without a law in time", "own simulator")


@pytest.mark.parametrize("to", TARGETS)
def test_one_line_and_nothing_written(to, here, made_up_campaign, capsys, monkeypatch):
    monkeypatch.chdir(here)

    def tree():
        return {str(p): p.read_bytes() for p in here.rglob("*") if p.is_file()}

    def said(run, given, expected=2):
        given = {"to": to, "out": "out"} | given
        if given.get("campaign") == "made_up":
            given["campaign"] = str(made_up_campaign)
        words = [word for name, x in given.items() for word in ((f"--{name}", x) if x is not None else (f"--{name}",))]
        code = main(["export", run, *words])
        error = capsys.readouterr().err
        assert code == expected, error
        return error

    before = tree()
    for name in CASES if to == "c" else BY_EACH:
        run, given, message = CASES[name]
        error = said(run, given)
        assert message in error and error.count("\n") == 1 and "defect" not in error, f"{name}: {error}"
        assert tree() == before and not (here / "out").exists(), name
    own = {"simulator": "spring.py", "draws": "1"}
    if to == "json":
        assert said("own", own, 0) == ""
    else:
        assert "cannot be written in C" in said("own", own)
    if to != "opensees":
        for option in ({"approximate": None}, {"error": "0.1"}):
            assert "for opensees alone" in said("run", option)
    else:
        assert "error must lie between 0 and 0.5" in said("run", {"error": "nan"})
    if os.geteuid():
        (here / "locked").mkdir(mode=0o500)
        assert "cannot be written to" in said("run", {"out": "locked/x"})
    shutil.rmtree(here / "out", ignore_errors=True)


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize("to", TARGETS)
def test_names_with_spaces_and_umlauts_and_no_draws(to, here, capsys, monkeypatch):
    monkeypatch.chdir(here)
    out = here / "Größe, mit Leerzeichen"
    assert main(["export", "Lauf mit Umläuten ß", "--to", to, "--out", out.name, "--draws", "0"]) == 0
    assert json.loads((out / "model_card.json").read_text())["draws"] == 0
    capsys.readouterr()
    shutil.rmtree(out)
