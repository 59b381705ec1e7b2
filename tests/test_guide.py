"""The guide: every command and block of code on its pages runs, its notebooks run, its site opens in a browser."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from bayes_iwan import cli

ROOT = Path(__file__).parents[1]
GUIDE = ROOT / "analyses" / "guide"
if not GUIDE.is_dir():
    pytest.skip("the guide is not part of this installation", allow_module_level=True)
PAGES = sorted(GUIDE.glob("*.md"))
#: their code needs other simulators: tests/export runs it
EXPORT = [page for page in PAGES if page.name.startswith("export_")]
BROWSER = next((p for p in map(shutil.which, ("chromium", "chromium-browser", "google-chrome")) if p), None)
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}


@dataclass(frozen=True)
class Block:
    """A block of code: its language, its text, its line on the page, and what the comment before it says of it."""

    language: str
    text: str
    line: int
    mark: str

    @property
    def file(self) -> str:
        """The file that the block shows, "" if it is to be run."""
        first = re.match(r"# (\S+\.(?:py|toml))\n", self.text)
        return first[1] if first else ""

    @property
    def commands(self) -> list[list[str]]:
        return [
            shlex.split(line, comments=True) for line in self.text.replace("\\\n", " ").splitlines() if line.strip()
        ]


def blocks_of(page: Path) -> list[Block]:
    """The blocks of a page in order."""
    text = page.read_text(encoding="utf-8")
    found = re.finditer(r"(?:<!-- ([a-z ]+) -->\n)?^```(\w+)\n(.*?)^```$", text, re.S | re.M)
    return [Block(m[2], m[3], text[: m.start(2)].count("\n") + 1, m[1] or "") for m in found]


def options_exist(command: list[str]) -> None:
    """Fails if a command has options or words that its program does not know."""
    if command[0] == "bayes-iwan":
        try:
            cli.parser().parse_args(command[1:])
        except SystemExit as error:
            pytest.fail(f"{shlex.join(command)}: exit {error.code}")
    elif command[0] == "python":
        script = ROOT / command[1]
        assert script.is_file(), command[1]
        text = script.read_text(encoding="utf-8")
        for word in command[2:]:
            assert not word.startswith("--") or f'"{word}"' in text, f"{command[1]} has no {word}"


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    """A folder with what a reader has in the root of the repository, of the campaigns the tests at 15 Hz."""
    for name in ("rope_spring", "rope_spring_accelerometer"):
        shutil.copytree(ROOT / "data" / name, tmp_path / "data" / name)
        file = tmp_path / "data" / name / "campaign.toml"
        head, *tests = file.read_text(encoding="utf-8").split("[[test]]")
        file.write_text("[[test]]".join([head, *(x for x in tests if "f15_" in x)]), encoding="utf-8")
    shutil.copytree(ROOT / "analyses", tmp_path / "analyses", ignore=shutil.ignore_patterns("pictures", "guide"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def run(command: list[str]) -> None:
    """Run a command of the page: the package's own in this process, scripts in one of their own."""
    if command[0] == "bayes-iwan":
        assert cli.main(command[1:]) in (0, None), shlex.join(command)
        return
    assert command[0] == "python", f"{command[0]}: pages have bayes-iwan and python commands only"
    done = subprocess.run([sys.executable, *command[1:]], env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.parametrize("page", [p for p in PAGES if p not in EXPORT], ids=lambda p: p.stem)
def test_what_a_page_shows_runs(page, workplace, no_pictures, few_quick_walkers):
    namespace = {"__name__": "shown"}
    for block in blocks_of(page):
        where = f"{page.name}:{block.line}"
        if block.file:
            (workplace / block.file).write_text(block.text, encoding="utf-8")
            sys.modules.pop(Path(block.file).stem, None)
        elif block.language == "python":
            code = compile(block.text, where, "exec")
            if not block.mark:
                exec(code, namespace)
        elif block.language == "bash":
            for command in block.commands:
                if block.mark:
                    options_exist(command)
                else:
                    run(command)
        else:
            assert block.language == "toml", f"{where}: {block.language}"


def test_commands_of_pages_about_export_have_the_options_that_they_show():
    for page in EXPORT:
        for block in blocks_of(page):
            if block.language in ("sh", "bash"):
                for command in block.commands:
                    options_exist(command)
            elif block.language == "python":
                compile(block.text, page.name, "exec")


def test_blocks_are_marked_by_known_words():
    marks = {block.mark for page in PAGES for block in blocks_of(page)}
    assert marks <= {"", "takes minutes", "not run"}
    assert sum(len(blocks_of(page)) for page in PAGES) > 25


def test_an_unknown_option_is_found():
    with pytest.raises(pytest.fail.Exception):
        options_exist(["bayes-iwan", "identify", "x", "--out", "y", "--no-such-option"])
    with pytest.raises(AssertionError):
        options_exist(["python", "analyses/own_effect.py", "--no-such-option"])


def test_notebooks_run(workplace, monkeypatch, few_quick_walkers):
    """In one kernel, which takes seconds to start; none has the names of the one before."""
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    cells, last = [nbformat.v4.new_code_cell(few_quick_walkers)], []
    for name in ("identify", "diagnose", "own_effect"):
        notebook = nbformat.read(GUIDE / "notebooks" / f"{name}.ipynb", as_version=4)
        assert all(not cell.get("outputs") for cell in notebook.cells), "notebooks are kept without their output"
        cells += [nbformat.v4.new_code_cell("%reset -f"), *notebook.cells]
        last.append([cell for cell in notebook.cells if cell.cell_type == "code"][-1])
    notebook.cells = cells
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(workplace)}}).execute()
    assert all(cell.outputs for cell in last), "the last cell shows something"


def test_every_command_of_the_package_is_on_a_page():
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    actions = next(a for a in cli.parser()._actions if isinstance(a, argparse._SubParsersAction))
    assert not [name for name in actions.choices if f"bayes-iwan {name}" not in text]


def test_every_option_of_the_package_is_on_a_page_and_how_the_tab_key_is_switched_on(capsys):
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    flags = {(x.name, f) for x in cli.COMMANDS for a in x.arguments for f in a.flags if f.startswith("--")}
    assert not [(name, flag) for name, flag in sorted(flags) if flag not in text]
    with pytest.raises(SystemExit):
        cli.main(["--help"])
    switch = 'eval "$(register-python-argcomplete bayes-iwan)"'
    said = capsys.readouterr().out
    assert switch in text and switch in (ROOT / "README.md").read_text(encoding="utf-8")
    assert switch.split()[0] in said and "register-python-argcomplete" in said
