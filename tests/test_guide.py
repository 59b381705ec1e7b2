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
from html.parser import HTMLParser
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
    """A folder with what a reader has in the root of the repository."""
    for name in ("rope_spring", "rope_spring_accelerometer"):
        shutil.copytree(ROOT / "data" / name, tmp_path / "data" / name)
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
def test_what_a_page_shows_runs(page, workplace, no_pictures):
    namespace = {"__name__": "shown"}
    for block in blocks_of(page):
        where = f"{page.name}:{block.line}"
        if block.file:
            (workplace / block.file).write_text(block.text, encoding="utf-8")
            sys.modules.pop(Path(block.file).stem, None)
        elif block.language == "python":
            exec(compile(block.text, where, "exec"), namespace)
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


@pytest.mark.parametrize("name", ["identify", "diagnose", "own_effect"])
def test_notebook_runs(name):
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    notebook = nbformat.read(GUIDE / "notebooks" / f"{name}.ipynb", as_version=4)
    assert all(not cell.get("outputs") for cell in notebook.cells), "notebooks are kept without their output"
    os_path = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = str(ROOT)
    try:
        nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(ROOT)}}).execute()
    finally:
        os.environ.pop("PYTHONPATH") if os_path is None else os.environ.update(PYTHONPATH=os_path)
    last = [cell for cell in notebook.cells if cell.cell_type == "code"][-1]
    assert last.outputs, "the last cell shows something"


# ---- the site ----


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocs")
    out = tmp_path_factory.mktemp("guide") / "site"
    command = [sys.executable, "-W", "error::UserWarning", str(GUIDE / "build.py"), "--out", str(out)]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return out


class Links(HTMLParser):
    """Addresses and names of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.used: set[str] = set()
        self.names: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.names |= {x for x in (given.get("id"), given.get("name")) if x}
        if tag in ("a", "link"):
            self.used.add(given.get("href") or "")
        elif tag in ("img", "script"):
            self.used.add(given.get("src") or "")


def test_links_lead_somewhere_and_nothing_is_loaded_from_outside(site):
    pages = {p: Links(p.read_text(encoding="utf-8")) for p in site.glob("*.html")}
    assert len(pages) >= len(PAGES)
    for page, links in pages.items():
        if page.name == "404.html":
            continue  # made for a server's root
        for link in links.used:
            path, _, name = link.partition("#")
            if not link or re.match(r"[a-z]+:", path):
                continue
            target = page if not path else (page.parent / path)
            assert target.exists(), f"{page.name}: {link}"
            if name and target in pages:
                assert name in pages[target].names, f"{page.name}: {link}"
    outside = re.compile(r"<(?:script|img|link)[^>]+(?:src|href)=\"https?:")
    assert not [p.name for p in site.rglob("*.html") if outside.search(p.read_text(encoding="utf-8"))]


def test_formulae_are_mathml(site):
    text = (site / "how_it_decides.html").read_text(encoding="utf-8")
    assert text.count("<math") > 20 and "$" not in re.sub(r"<script.*?</script>", "", text, flags=re.S)


def opened(address: str, folder: Path) -> tuple[str, str]:
    """The page as Chromium shows it, and what it says."""
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
    options += [f"--user-data-dir={folder}", "--enable-logging=stderr", "--virtual-time-budget=10000", "--dump-dom"]
    done = subprocess.run([str(BROWSER), *options, address], capture_output=True, text=True, timeout=180, check=False)
    return done.stdout, "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here; to run this test: apt-get install -y chromium")
def test_site_opens_in_a_browser_and_finds_words(site, tmp_path):
    shown, said = opened((site / "index.html").as_uri(), tmp_path)
    assert "First identification" in shown and said == ""
    shown, said = opened((site / "search.html").as_uri() + "?q=compliance", tmp_path)
    assert said == "" and re.search(r"[1-9]\d* places? for “compliance”", shown), shown[-2000:]
    assert 'href="./glossary.html' in shown
    shown, said = opened((site / "search.html").as_uri() + "?q=identify", tmp_path)
    assert 'href="./api/bayes_iwan.html#identify"' in shown
    shown, said = opened((site / "api" / "bayes_iwan.html").as_uri(), tmp_path)
    assert 'id="identify"' in shown and said == ""


def test_every_command_of_the_package_is_on_a_page():
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    actions = next(a for a in cli.parser()._actions if isinstance(a, argparse._SubParsersAction))
    assert not [name for name in actions.choices if f"bayes-iwan {name}" not in text]
