"""The guide's pages on exporting: their code runs as it stands, where the simulator is installed."""

import shutil

import pytest

import run_guide

NEEDS = {"export_mujoco": "mujoco", "export_fmu": "fmpy", "export_opensees": "openseespy.opensees"}
#: shorter than a reader would run it
SHORTER = {"export_uncertainty": {"6.0, 30.0, 30": "6.0, 30.0, 3", "range(SETS)": "range(2)", "[1:]": ""}}


@pytest.mark.usefixtures("compiler")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("page", run_guide.PAGES)
def test_a_pages_code_runs(page, problem_of, draws, exported, tmp_path):
    if page in NEEDS:
        try:
            pytest.importorskip(NEEDS[page], reason=f"pip install {NEEDS[page].split('.')[0]}")
        except RuntimeError as error:  # OpenSees without libblas3
            pytest.skip(" ".join(str(error).split()))
    target, constant = run_guide.PAGES[page]
    problem = problem_of(normal_force="constant", stiffness="constant") if constant else problem_of()
    shutil.copytree(exported(problem, draws(problem, 6), target), tmp_path / "isolator")
    run_guide.run_page(page, tmp_path, SHORTER.get(page))
    assert page == "export_mujoco" or (tmp_path / f"{page}.png").stat().st_size > 5000


def test_every_picture_of_a_page_is_there():
    for page in run_guide.PAGES:
        text = (run_guide.GUIDE / f"{page}.md").read_text(encoding="utf-8")
        assert f"../pictures/{page}.png" in text and (run_guide.PICTURES / f"{page}.png").is_file()
