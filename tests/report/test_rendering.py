"""Figures drawn by a second process are those that this one draws, and a process that is lost loses none."""

from __future__ import annotations

import io
import subprocess
import sys

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.ticker import FuncFormatter
from PIL import Image
from pypdf import PdfReader

from bayes_iwan.report import rendering
from bayes_iwan.report.page import Page
from bayes_iwan.report.rendering import Order, Renderer
from bayes_iwan.report.style import subplots


def figures():
    for i in range(3):
        figure, axes = subplots(1, 2, 4, 2)
        axes[0, 0].plot([0, 1, 2], [0, i, 1], label=f"line {i}")
        axes[0, 0].set_xlabel(f"displacement {i} (mm)")
        axes[0, 1].set_title("α", loc="left")
        axes[0, 0].legend()
        yield Order(f"figure-{i}", f"picture {i}", True), figure


@pytest.fixture(autouse=True)
def two_threads(monkeypatch):
    """A second process is begun where this one may use more than one thread."""
    monkeypatch.setattr(rendering.nb, "get_num_threads", lambda: 2)


def drawn(renderer, pairs):
    orders = []
    for order, figure in pairs:
        renderer.order(order, figure)
        orders.append(order)
    return [renderer.rendered(o) for o in orders]


@pytest.fixture(scope="module")
def here():
    """As this process draws them."""
    return drawn(Renderer(), figures())


def same(one, other):
    assert [(x.svg, x.png) for x in one] == [(x.svg, x.png) for x in other] and len(one) == len(other)
    for x, again in zip(one, other):
        a, b = (PdfReader(io.BytesIO(content)).pages[0] for content in (x.pdf, again.pdf))
        assert a.get_contents().get_data() == b.get_contents().get_data() and "mm" in a.extract_text()


def test_a_second_process_draws_the_same(monkeypatch):
    asked, draw = [], rendering.drawn
    monkeypatch.setattr(rendering, "drawn", lambda orders: asked.append(len(orders)) or draw(orders))
    with mpl.rc_context({"lines.solid_capstyle": "round"}):  # the caller's settings are the second process's too
        there = drawn(Renderer(aside=True), figures())
        assert asked == [2]  # of three
        same(there, drawn(Renderer(), figures()))


def test_the_same_files_in_every_run():
    one, other = (drawn(Renderer(aside=True), figures()) for _ in range(2))
    assert one == other


@pytest.mark.parametrize(
    "code", ["", "import sys; sys.stdin.buffer.read(9000); raise SystemExit(1)", "print('x' * 99)"]
)
def test_a_process_that_dies_loses_no_figure(code, here, monkeypatch):
    def start():
        return subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    monkeypatch.setattr(rendering, "_start", start)
    same(drawn(Renderer(aside=True), figures()), here)


def test_no_second_python_no_loss(here, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    same(drawn(Renderer(aside=True), figures()), here)


def test_a_figure_that_cannot_travel_is_drawn_here():
    def pairs():
        for order, figure in figures():
            figure.axes[0].xaxis.set_major_formatter(FuncFormatter(lambda x, at: f"{x:g} mm"))
            yield order, figure

    same(drawn(Renderer(aside=True), pairs()), drawn(Renderer(), pairs()))


def test_a_page_s_files_come_from_both_processes(tmp_path, figure_files):
    page = Page("both", renderer=Renderer(aside=True))
    section = page.section("one")
    for order, figure in figures():
        section.figure(figure, "c", "a", name=order.name)
    text = page.write(tmp_path / "page.html").read_text()
    assert text.count("<svg") == 3 and "displacement 2 (mm)" in text
    for i in range(3):
        with Image.open(tmp_path / "figures" / f"page_figure-{i}.png") as picture:
            assert picture.size == (600, 300)
        assert (tmp_path / "figures" / f"page_figure-{i}.pdf").read_bytes().startswith(b"%PDF")


def test_no_label_is_cut_off_in_the_files():
    figure, axes = subplots(1, 1, 4, 2)
    axes[0, 0].barh([0, 1], [0.2, 0.9])
    axes[0, 0].set_yticks([0, 1], ["unknown: something else is there", "none: the model suffices"])
    order = Order("bars", "bars", True)
    renderer = Renderer()
    renderer.order(order, figure)
    with Image.open(io.BytesIO(renderer.rendered(order).png)) as picture:
        margin = np.asarray(picture.convert("L"))[:, :4]
    assert (margin == 255).all()
