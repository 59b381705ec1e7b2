"""Run the Python of the guide's pages on exporting, and make their pictures.

    python analyses/run_guide.py [PAGE ...]        # default: all four; pictures go to analyses/pictures

Identifies data/rope_spring quickly (Laplace's draws), exports it as each page says, and runs the page's code beside it.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

import matplotlib

import bayes_iwan as bi

GUIDE, PICTURES = Path(__file__).parent / "guide", Path(__file__).parent / "pictures"
#: target of each page's export, and whether its model has a constant normal force
PAGES = {
    "export_mujoco": ("mujoco", False),
    "export_fmu": ("fmu", False),
    "export_opensees": ("opensees", True),
    "export_uncertainty": ("c", False),
}


def code_of(page: str) -> str:
    """All Python of a page."""
    text = (GUIDE / f"{page}.md").read_text(encoding="utf-8")
    return "\n".join(re.findall(r"^```python\n(.*?)^```", text, re.S | re.M))


def run_page(page: str, folder: Path, replaced: dict[str, str] | None = None) -> None:
    """Run a page's code in a folder that holds its export as `isolator`; pictures are left there."""
    code = code_of(page)
    for old, new in (replaced or {}).items():
        code = code.replace(old, new)
    matplotlib.use("agg")
    from matplotlib import pyplot

    before = os.getcwd()
    sys.path.insert(0, str(folder / "isolator"))
    for stale in [n for n in sys.modules if n.startswith("isolator")]:
        del sys.modules[stale]
    os.chdir(folder)
    try:
        pyplot.figure(figsize=(5.6, 3.6), layout="constrained")
        exec(compile(code, f"{page}.md", "exec"), {})
    finally:
        pyplot.close("all")
        os.chdir(before)
        sys.path.remove(str(folder / "isolator"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", nargs="*", default=list(PAGES))
    args = parser.parse_args()
    campaign = Path(__file__).parents[1] / "data" / "rope_spring"
    for page in args.pages:
        target, constant = PAGES[page]
        config = (
            {"model": {"normal_force": "constant", "stiffness": "constant", "embedded": False}} if constant else None
        )
        folder = Path(tempfile.mkdtemp())
        posterior = bi.identify(campaign, quick=True, seed=1, progress=False, config=config)
        posterior.export(target, folder / "isolator")
        run_page(page, folder)
        for picture in folder.glob("*.png"):
            shutil.copy(picture, PICTURES / picture.name)
            print(PICTURES / picture.name)


if __name__ == "__main__":
    main()
