"""The pages of API documentation, from the docstrings of all that `import bayes_iwan` offers.

    python analyses/api_pages.py [--out runs/api]

The package imports its public names when they are first asked for; pdoc does not ask, so they are all asked for here.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pdoc

import bayes_iwan


def write_pages(out: Path) -> Path:
    """Write the pages; returns the first."""
    for name in bayes_iwan.__all__:
        setattr(bayes_iwan, name, getattr(bayes_iwan, name))
    pdoc.render.configure(docformat="numpy", show_source=False, math=False)
    pdoc.pdoc("bayes_iwan", output_directory=out)
    return out / "bayes_iwan.html"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/api"))
    print(write_pages(parser.parse_args().out))


if __name__ == "__main__":
    main()
