"""The order of folders: a folder imports from those to its left only (campaign → … → report)."""

import ast
import tomllib
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import bayes_iwan

PACKAGE = Path(bayes_iwan.__file__).parent
FOLDERS = (
    "campaign",
    "models",
    "effects",
    "fitting",
    "sampling",
    "inference",
    "comparison",
    "diagnosis",
    "export",
    "virtual_rig",
    "withheld",
    "report",
)
#: the order within the largest folders
INNER = {
    "campaign": ("recording", "timing", "loops", "folders", "importing"),
    "inference": ("setup", "solving", "results"),
    "diagnosis": ("fits", "search", "assessment", "answer"),
}
#: what every folder may use, and what the two that know no friction, and the independent rig, may use besides
OPEN = {"arguments", "arrays", "errors", "executors", "files", "former_names", "screen", "terminal", "threads"}
ALONE = {"fitting": set(), "sampling": set(), "virtual_rig": {"campaign"}}
FILES = sorted(p.relative_to(PACKAGE) for p in PACKAGE.rglob("*.py"))


def imports_of(path: Path) -> set[str]:
    out = set()
    for node in ast.walk(ast.parse((PACKAGE / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            out |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import; the house imports absolutely"
            out |= (
                {f"{node.module}.{alias.name}" for alias in node.names}
                if node.module == "bayes_iwan"
                else {node.module}
            )
    return out


@pytest.mark.parametrize("path", [p for p in FILES if len(p.parts) > 1 and p.parts[0] != "cli"], ids=str)
def test_a_folder_imports_from_folders_to_its_left_only(path):
    folder = path.parts[0]
    assert folder in FOLDERS, f"{folder} is not among the folders"
    used = {name.split(".")[1] for name in imports_of(path) if name.startswith("bayes_iwan.")}
    allowed = ALONE.get(folder, set(FOLDERS[: FOLDERS.index(folder)])) | OPEN | {folder, "__version__"}
    assert used <= allowed, f"{path} imports {sorted(used - allowed)}"


@pytest.mark.parametrize("path", [p for p in FILES if p.parts[0] in INNER and len(p.parts) > 2], ids=str)
def test_within_a_folder_too(path):
    folder, part = path.parts[:2]
    used = {name.split(".")[2] for name in imports_of(path) if name.startswith(f"bayes_iwan.{folder}.")}
    allowed = set(INNER[folder][: INNER[folder].index(part) + 1])
    assert used <= allowed | {"constants"}, f"{path} imports {sorted(used - allowed)}"


def loaded_with(path: Path) -> set[str]:
    """Files of the package that are imported when a file is, by module."""
    out = set()
    for node in ast.parse((PACKAGE / path).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import):
            out |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            out |= {name if name in MODULES else str(node.module) for name in names}
    return out & set(MODULES)


MODULES = {".".join(("bayes_iwan", *p.with_suffix("").parts)).removesuffix(".__init__"): p for p in FILES}


def test_no_files_import_each_other_in_a_circle():
    graph = {name: loaded_with(path) - {name} for name, path in MODULES.items()}
    list(TopologicalSorter(graph).static_order())  # raises CycleError, which shows the circle


def test_no_two_files_have_one_name():
    names = [p.name for p in FILES if not p.name.startswith("__")]
    assert not {n for n in names if names.count(n) > 1}


def test_nothing_imports_the_command_line():
    inside = [p for p in FILES if p.parts[0] not in ("cli", "__main__.py")]
    assert not [str(p) for p in inside if any(name.startswith("bayes_iwan.cli") for name in imports_of(p))]


def test_matplotlib_is_imported_in_report_alone():
    found = {p.parts[0] for p in FILES if any(name.split(".")[0] == "matplotlib" for name in imports_of(p))}
    assert found == {"report"}


def called(path: Path) -> set[str]:
    """Names of functions that are called, as they are written before the bracket."""
    tree = ast.parse((PACKAGE / path).read_text(encoding="utf-8"))
    return {ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}


def test_no_file_that_is_read_can_run_as_code():
    """No pickle and its like, no eval, no shell; Python files are run in one place, for a user who names the file."""
    modules = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "yaml", "code", "runpy"}
    loaders = set()
    for path in FILES:
        text = (PACKAGE / path).read_text(encoding="utf-8")
        assert not modules & {name.split(".")[0] for name in imports_of(path)}, path
        names = called(path)
        assert not {"eval", "exec", "compile", "__import__", "os.system", "os.popen"} & names, path
        assert "allow_pickle=True" not in text and "shell=True" not in text, path
        if any(name.endswith("exec_module") for name in names):
            loaders.add(str(path))
    assert loaders == {"models/user_file.py"}


def test_extra_and_dependency_groups_for_development_are_the_same():
    root = Path(__file__).parents[1]
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    groups = project["dependency-groups"]
    wanted = [x for entry in groups["dev"] for x in groups[entry["include-group"]]]
    assert sorted(project["project"]["optional-dependencies"]["dev"]) == sorted(wanted)


def test_citation_states_the_version():
    citation = (Path(__file__).parents[1] / ".github" / "CITATION.cff").read_text(encoding="utf-8")
    assert f"version: {bayes_iwan.__version__}\n" in citation
