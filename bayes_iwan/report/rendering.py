"""A page's figures as SVG, PNG and PDF: shared with a second process, which draws while the next ones are made; the
others are drawn here once all are.

Drawing is pure Python and takes longer than all else that a page is made of; a second core halves it. Which process
draws which figure depends on the figures alone, never on who is faster, so the files are the same in every run. Where
the second process cannot be had or is lost, this one draws all of them.
"""

import io
import os
import signal
import subprocess
import sys
import threading
import warnings
import weakref
from concurrent.futures import Future
from dataclasses import dataclass, field
from multiprocessing.reduction import ForkingPickler
from queue import SimpleQueue
from typing import IO, Any

import matplotlib as mpl
import numba as nb
from markupsafe import Markup
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from pypdf import PdfReader, PdfWriter

from bayes_iwan.report.style import DPI, RC, settle
from bayes_iwan.report.svg import svg

#: PNG files a little larger than the smallest, in a third of the time
_PNG: dict[str, Any] = {"format": "png", "dpi": DPI, "pil_kwargs": {"compress_level": 3}}
#: the second process: deaf to Ctrl-C from its first line on, it ends when its input does
_SERVE = (
    "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); from bayes_iwan.report.rendering import serve; "
    "serve()"
)


@dataclass(frozen=True)
class Order:
    """What a figure is to become: an <svg> whose ids begin with `name`, and files of some kinds, "png" and "pdf".
    alt : what a reader would see in it."""

    name: str
    alt: str
    files: tuple[str, ...]


@dataclass(frozen=True)
class Rendered:
    """A figure as a page holds it, and its PNG file's content (empty where it was not asked for)."""

    svg: Markup
    png: bytes


@dataclass
class Batch:
    """Figures that one process draws. Their PDFs are pages of one file until the end, since picking the letters out of
    a font costs more than drawing a figure, and is so done once."""

    _whole: io.BytesIO = field(default_factory=io.BytesIO)
    _pages: PdfPages | None = None
    _names: list[str] = field(default_factory=list)

    def draw(self, order: Order, figure: Figure) -> Rendered:
        settle(figure)
        with mpl.rc_context(RC):
            png = b""
            if "png" in order.files:
                content = io.BytesIO()
                figure.savefig(content, **_PNG)
                png = content.getvalue()
            if "pdf" in order.files:
                self._pages = self._pages or PdfPages(self._whole, metadata={"CreationDate": None})
                self._pages.savefig(figure)  # type: ignore[no-untyped-call]
                self._names.append(order.name)
        return Rendered(svg(figure, order.name, order.alt), png)

    def pdfs(self) -> dict[str, bytes]:
        """The PDF file of every figure that was to have one, by the order's name. Nothing can be drawn afterwards."""
        if self._pages is None:
            return {}
        with mpl.rc_context(RC):
            self._pages.close()  # type: ignore[no-untyped-call]
        out = {}
        for name, page in zip(self._names, PdfReader(self._whole).pages):
            one, content = PdfWriter(), io.BytesIO()
            one.add_page(page)
            one.write(content)
            out[name] = content.getvalue()
        return out


class Renderer:
    """The figures of one page.

    aside : share them with a second process. busy : what this process has to do while it orders, as :func:`_work` of
    drawing: so much of it the other one begins with at once; the others are shared out when all is ordered.
    """

    def __init__(self, aside: bool = False, busy: int = 0) -> None:
        self._aside = _Aside() if aside else None
        self._ahead = -busy  # work that the second process has beyond what this one does meanwhile
        self._here = Batch()
        self._ordered: dict[Order, Figure] = {}
        self._drawn: dict[Order, Rendered | Future[object]] = {}
        self._pdfs: dict[str, bytes] | None = None
        if self._aside is not None:
            weakref.finalize(self, self._aside.end)  # of a page that was never written

    def order(self, order: Order, figure: Figure) -> None:
        """A figure that is to be drawn; one that was ordered before, by whoever knew that it would come, is not drawn
        twice."""
        if order in self._ordered:
            return
        self._ordered[order] = figure
        if self._aside is not None and self._ahead < 0:
            self._ahead += _work(figure)
            self._drawn[order] = self._aside.ask(order, figure)

    def rendered(self, order: Order) -> Rendered:
        """What has become of a figure; waits for it."""
        self._draw()
        found = self._drawn[order]
        if isinstance(found, Rendered):
            return found
        try:
            answer = found.result()
        except _LostError:
            self._alone()
            return self.rendered(order)
        assert isinstance(answer, Rendered)
        self._drawn[order] = answer
        return answer

    def pdfs(self) -> dict[str, bytes]:
        """The PDF files by the orders' names; no figure can be ordered afterwards."""
        if self._pdfs is None:
            self._draw()
            there = None if self._aside is None else self._aside.ask()
            self._pdfs = self._here.pdfs()
            try:
                more = {} if there is None else there.result()
                assert isinstance(more, dict)
                self._pdfs |= more
            except _LostError:
                self._alone()
                self._pdfs = self._here.pdfs()
            if self._aside is not None:
                self._aside.end()
        return self._pdfs

    def _draw(self) -> None:
        """Everything that was not begun yet, the largest first, each by the process that has less to do."""
        left = [order for order in self._ordered if order not in self._drawn]
        own, load = [], {True: max(self._ahead, 0), False: 0}
        for order in sorted(left, key=lambda order: -_work(self._ordered[order])):
            figure = self._ordered[order]
            there = self._aside is not None and load[True] < load[False]
            load[there] += _work(figure)
            if self._aside is not None and there:
                self._drawn[order] = self._aside.ask(order, figure)
            else:
                own.append(order)
        for order in own:
            self._drawn[order] = self._here.draw(order, self._ordered[order])

    def _alone(self) -> None:
        """Everything anew in this process."""
        self._aside, self._here, self._drawn = None, Batch(), {}
        self._draw()


def _work(figure: Figure) -> int:
    """What a figure costs to draw, in tenths of a second or so: a panel counts one, and every figure two besides."""
    return 2 + len(figure.axes)


def shared(busy: int = 0) -> Renderer:
    """One that draws in a second process too, where this one may use more than one thread. It takes a second to start:
    whoever makes it before there are figures has it ready when there are."""
    return Renderer(nb.get_num_threads() > 1, busy)


# ---- the second process


class _LostError(Exception):
    """The second process did not answer."""


class _Aside:
    """A Python process of its own that draws; not one of `multiprocessing`, which would run a script without
    `if __name__ == "__main__":` a second time."""

    def __init__(self) -> None:
        self._asked: SimpleQueue[tuple[bytes, Future[object]] | None] = SimpleQueue()
        threading.Thread(target=self._talk, daemon=True, name="figures").start()
        settings = dict(mpl.rcParams.copy())
        del settings["backend"]  # of windows, which are none of its business
        self.ask(settings)

    def ask(self, *message: object) -> Future[object]:
        """The answer to come. What is asked is read here and now: the caller may go on to change it."""
        answer: Future[object] = Future()
        try:
            content = bytes(ForkingPickler.dumps(message))
        except Exception as error:  # whatever a figure may hold that cannot travel
            answer.set_exception(_LostError(str(error)))
        else:
            self._asked.put((content, answer))
        return answer

    def end(self) -> None:
        self._asked.put(None)

    def _talk(self) -> None:
        process: subprocess.Popen[bytes] | None = None
        lost: Exception | None = None
        while (asked := self._asked.get()) is not None:
            content, answer = asked
            try:
                if lost is not None:
                    raise lost
                process = process or _start()
                assert process.stdin is not None and process.stdout is not None
                _send(process.stdin, content)
                answer.set_result(_receive(process.stdout))
            except Exception as error:
                lost = error
                answer.set_exception(_LostError(str(error)))
        if process is not None:
            process.communicate()


def _start() -> subprocess.Popen[bytes]:
    command, environment = [sys.executable, "-c", _SERVE], os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    flags, pipe = getattr(subprocess, "CREATE_NO_WINDOW", 0), subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, env=environment, creationflags=flags)


def serve() -> None:
    """The second process's work: settings first, then orders with their figures, then () for the PDFs."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers, sys.stdout = sys.stdout.buffer, sys.stderr
    batch = Batch()
    try:
        while True:
            match _receive(sys.stdin.buffer):
                case (settings,):
                    with warnings.catch_warnings(action="ignore"):  # the caller has heard them
                        mpl.rcParams.update(settings)
                    answer: object = None
                case (order, figure):
                    answer = batch.draw(order, figure)
                case _:
                    answer = batch.pdfs()
            _send(answers, bytes(ForkingPickler.dumps(answer)))
    except (EOFError, BrokenPipeError):  # whoever asked has gone
        os._exit(0)


def _send(pipe: IO[bytes], content: bytes) -> None:
    pipe.write(len(content).to_bytes(8, "little") + content)
    pipe.flush()


def _receive(pipe: IO[bytes]) -> Any:
    head = pipe.read(8)
    content = pipe.read(int.from_bytes(head, "little")) if len(head) == 8 else b""
    if not content:
        raise EOFError("the other process has ended")
    return ForkingPickler.loads(content)
