"""A page's figures as SVG, PNG and PDF, drawn all at once; where it helps, half of them by a second process.

Drawing is pure Python and takes longer than all else that a page is made of. Which process draws which figure depends
on the figures alone, so the files are the same in every run. Where the second process cannot be had or is lost, this
one draws all of them.
"""

import contextlib
import io
import os
import signal
import subprocess
import sys
import warnings
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from multiprocessing.reduction import ForkingPickler

import matplotlib as mpl
import numba as nb
from markupsafe import Markup
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from pypdf import PdfReader, PdfWriter

from bayes_iwan.report.style import DPI, RC, keep_labels, settle
from bayes_iwan.report.svg import svg

#: the second process: deaf to Ctrl-C from its first line on, it ends when its input does
_SERVE = (
    "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); from bayes_iwan.report.rendering import serve; "
    "serve()"
)


@dataclass(frozen=True)
class Order:
    """What a figure is to become: an <svg> whose ids are those of no other `name`, and a PNG and a PDF file where
    `files` says so. alt : what a reader would see in it."""

    name: str
    alt: str
    files: bool


@dataclass(frozen=True)
class Rendered:
    """A figure as a page holds it, and the content of its files (empty where none was asked for)."""

    svg: Markup
    png: bytes = b""
    pdf: bytes = b""


def drawn(orders: Mapping[Order, Figure]) -> dict[Order, Rendered]:
    """Every figure, drawn in this process. Their PDFs are pages of one file until the end, since picking the letters
    out of a font costs more than drawing a figure, and is so done once."""
    whole, pictures = io.BytesIO(), {}
    with mpl.rc_context(RC), PdfPages(whole, metadata={"CreationDate": None}) as pages:
        for order, figure in orders.items():
            settle(figure)
            png = io.BytesIO()
            if order.files:  # a little larger than the smallest, in a third of the time
                figure.savefig(png, format="png", dpi=DPI, pil_kwargs={"compress_level": 3})
                keep_labels(figure)
                pages.savefig(figure)
            pictures[order] = (svg(figure, order.name, order.alt), png.getvalue())
    pdfs = _single_pages(whole)
    return {order: Rendered(*made, next(pdfs) if order.files else b"") for order, made in pictures.items()}


def _single_pages(whole: io.BytesIO) -> Iterator[bytes]:
    """Each page of a PDF file as a file."""
    for page in PdfReader(whole).pages:
        one, content = PdfWriter(), io.BytesIO()
        one.add_page(page)
        one.write(content)
        yield content.getvalue()


class Renderer:
    """The figures of one page. aside : share them with a second process, where this one may use more than one thread.
    That takes a second to start: whoever makes the renderer before there are figures has it ready when there are."""

    def __init__(self, aside: bool = False) -> None:
        self._ordered: dict[Order, Figure] = {}
        self._done: dict[Order, Rendered] = {}
        self._aside = _start() if aside and nb.get_num_threads() > 1 else None
        if self._aside is not None:
            weakref.finalize(self, _end, self._aside)

    def order(self, order: Order, figure: Figure) -> None:
        """A figure that is to be drawn."""
        self._ordered[order] = figure

    def rendered(self, order: Order) -> Rendered:
        """What has become of a figure; the first time all that were ordered are drawn."""
        if order not in self._done:
            self._done |= self._shared({x: figure for x, figure in self._ordered.items() if x not in self._done})
        return self._done[order]

    def _shared(self, orders: Mapping[Order, Figure]) -> dict[Order, Rendered]:
        process, self._aside = self._aside, None
        if process is None or process.stdin is None or process.stdout is None:
            return drawn(orders)
        largest_first = sorted(orders, key=lambda order: -len(orders[order].axes))
        here, there = ({order: orders[order] for order in largest_first[first::2]} for first in (0, 1))
        settings = dict(mpl.rcParams.copy())
        del settings["backend"]  # of windows, which are none of its business
        try:
            process.stdin.write(ForkingPickler.dumps((settings, there)))
            process.stdin.close()
        except Exception:  # it has died, or a figure holds what cannot travel
            return drawn(orders)
        done = drawn(here)
        try:
            return done | ForkingPickler.loads(process.stdout.read())
        except Exception:
            return done | drawn(there)


def _start() -> subprocess.Popen[bytes] | None:
    """A Python process of its own that draws; not one of `multiprocessing`, which would run a script without
    `if __name__ == "__main__":` a second time."""
    command, environment = [sys.executable, "-c", _SERVE], os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    flags, pipe = getattr(subprocess, "CREATE_NO_WINDOW", 0), subprocess.PIPE
    try:
        return subprocess.Popen(command, stdin=pipe, stdout=pipe, env=environment, creationflags=flags)
    except OSError:
        return None


def _end(process: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(OSError), process:
        process.kill()


def serve() -> None:
    """The second process's work: settings and figures come once, and what was drawn goes back."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers, sys.stdout = sys.stdout.buffer, sys.stderr
    if content := sys.stdin.buffer.read():
        settings, orders = ForkingPickler.loads(content)
        with warnings.catch_warnings(action="ignore"):  # the caller has heard them
            mpl.rcParams.update(settings)
        answers.write(ForkingPickler.dumps(drawn(orders)))
