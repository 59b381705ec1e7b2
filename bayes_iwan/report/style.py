"""The look of every figure: colours that colour-blind readers can tell apart, sizes that survive print, files."""

from __future__ import annotations

import inspect
import io
import os
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import matplotlib as mpl
import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.mathtext import MathTextParser
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter
from matplotlib.typing import LineStyleType
from numpy.typing import NDArray

from bayes_iwan.errors import InputError, nearest
from bayes_iwan.files import replacing

if TYPE_CHECKING:
    from bayes_iwan.campaign.recording.units import Units

#: Okabe & Ito's palette; never the only sign: lines differ in dash and markers in shape too
BLACK, ORANGE, SKY, GREEN, BLUE = "#000000", "#E69F00", "#56B4E9", "#009E73", "#0072B2"
RED, PURPLE = "#D55E00", "#CC79A7"
MEASURED, MODEL, PRIOR = BLACK, BLUE, "#8A8A8A"
INK = "#111111"  # of letters on a pale colour: on a dark screen, where black turns white, it stays dark
_SERIES = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY, BLACK)
_DASHES: tuple[LineStyleType, ...] = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))
_MARKERS = "osD^vPX"

RC: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],
    "font.size": 9,
    "axes.titlesize": "medium",
    "figure.labelsize": "medium",
    "figure.titlesize": "medium",
    "legend.fontsize": "small",
    "xtick.labelsize": "small",
    "ytick.labelsize": "small",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.2,
    "lines.markersize": 4,
    "legend.frameon": False,
    "axes.unicode_minus": True,
    "path.simplify_threshold": 0.3,
    "svg.fonttype": "none",  # text stays text: a browser prints it so
    "pdf.fonttype": 42,  # the same in files: whole letters, which publishers ask for
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "figure.constrained_layout.w_pad": 0.09,  # a browser's letters are a little wider than those laid out
}

#: dots an inch of PNG files, at which figures are laid out: at 100 letters are hinted a tenth narrower than elsewhere,
#: and labels that fit there would be cut off in every file
DPI = 150

#: widths of figures in inches: one and two columns of a journal's page
WIDTHS: dict[str | float, float] = {"column": 3.5, 1: 3.5, "page": 7.2, 2: 7.2}

F = TypeVar("F", bound=Callable[..., Figure])


class StyleError(InputError):
    """A style, width or axes that a figure cannot be drawn with; the message says what fits."""


#: width in inches of the variant for a phone: on 360 px its letters of 7 pt are 9 px tall
PHONE = 3.6
LETTERS = 34  # of a label in so many inches
BESIDE = 1.15  # length of a label over that of its axes, where another panel follows
NARROW = 5.0  # inches: in less no more than two panels stand side by side, and legends beside nothing


class Shown(Figure):
    """A figure that shows itself in a notebook, whatever backend matplotlib has there.

    for_phone : draws the same again, PHONE wide and with panels that stood side by side below one another, unless one
    axis of names serves them all; None where the caller chose a width or gave axes.
    """

    for_phone: Callable[[], Figure] | None = None
    one_label = False  # do panels that lie below one another share the first one's label?

    def __getstate__(self) -> dict[str, object]:
        state: Any = super().__getstate__()
        return {**state, "for_phone": None}  # a function within one, which does not travel

    def _repr_png_(self) -> bytes:
        content = io.BytesIO()
        self.savefig(content, format="png", dpi=110, bbox_inches="tight")
        return content.getvalue()


@dataclass(frozen=True)
class _Wish:
    """What the caller of a figure function asked for: axes to draw into, a width in inches, and whether panels that
    would stand side by side stand below one another."""

    axes: tuple[Axes, ...] | None = None
    width: float | None = None
    stacked: bool = False


_NOTHING = _Wish()
_WISH: ContextVar[_Wish] = ContextVar("wish", default=_NOTHING)


def letters_on(colour: str) -> str:
    """The colour of letters that can be read on a bar of one of the palette's, on a dark screen too."""
    return "white" if colour in (BLACK, BLUE) else INK


def unset_rc() -> Any:
    """This module's settings where the user's rcParams are still matplotlib's own; what a user has set stands. All
    letters are so many times `font.size`, which so scales them."""
    return {key: value for key, value in RC.items() if mpl.rcParams[key] == mpl.rcParamsDefault[key]}


def styled(make: F) -> F:
    """A figure function that also takes

    style : None for this package's, with whatever the user's rcParams say; else a style of matplotlib (a name, a dict
        of rcParams or a list of them) put on top of that;
    width : "column" or 1 (3.5 in), "page" or 2 (7.2 in, two columns), or more inches than these;
    ax : the axes to draw into, an array of them for a figure with several panels.
    """

    @wraps(make)
    def inner(
        *args: object, style: Any = None, width: str | float | None = None, ax: object = None, **kwargs: Any
    ) -> Figure:
        width = width if width is None else WIDTHS.get(width, width)
        if isinstance(width, str):
            raise StyleError(f"width={width!r}: a number of inches, or a name{nearest(width, WIDTHS)}")
        if args and isinstance(args[0], str | os.PathLike):
            raise InputError(f"a figure is drawn of a result, not of a path; bi.load({str(args[0])!r}) reads one")
        given = None if ax is None else tuple(np.asarray(ax, dtype=object).ravel())
        outer = _WISH.get()

        def drawn(wish: _Wish) -> Figure:
            token = _WISH.set(wish)
            try:
                with mpl.rc_context(unset_rc()):
                    if style is None:
                        return make(*args, **kwargs)
                    with mpl.style.context(style):
                        return make(*args, **kwargs)
            except OSError as error:  # of a style that there is not
                near = nearest(style, mpl.style.available, "")
                raise StyleError(f"style={style!r}: {str(error).partition(';')[0]}{near}") from None
            finally:
                _WISH.reset(token)

        wish = _Wish(given, width) if (given or width) else outer
        figure = drawn(wish)
        if wish == _NOTHING and isinstance(figure, Shown):
            figure.for_phone = partial(_on_phone, drawn)
        return figure

    whole = inspect.signature(make)
    added = [p for p in inspect.signature(inner, follow_wrapped=False).parameters.values() if p.kind is p.KEYWORD_ONLY]
    inner.__signature__ = whole.replace(parameters=[*whole.parameters.values(), *added])  # type: ignore[attr-defined]
    return inner  # type: ignore[return-value]


def _on_phone(drawn: Callable[[_Wish], Figure]) -> Figure:
    """The variant for a phone: every panel has its label, and long ones take several lines."""
    figure = drawn(_Wish(width=PHONE, stacked=True))
    for axes in figure.axes:
        if isinstance(figure, Shown) and figure.one_label and not axes.get_ylabel():
            axes.set_ylabel(figure.axes[0].get_ylabel())
        place = axes.get_subplotspec()
        letters = LETTERS // (1 if place is None else place.get_gridspec().ncols)
        _in_lines(axes.xaxis.label, letters)
        for loc in ("left", "center", "right"):
            if (title := axes.get_title(loc)) and "\n" not in title:  # beside the ticks' labels
                with mpl.rc_context(unset_rc()):  # by which a title that is set anew is as large as it was
                    axes.set_title(textwrap.fill(title, 2 * letters // 3), loc=loc)
    for text in figure.texts:
        _in_lines(text, LETTERS)
    for text in (figure._supxlabel, figure._suptitle):  # type: ignore[attr-defined]
        if text is not None:
            _in_lines(text, LETTERS)
    return figure


def _in_lines(text: Text, letters: int) -> None:
    """A text without lines of its own in lines of so many letters."""
    if "\n" not in text.get_text():
        text.set_text(textwrap.fill(text.get_text(), letters))


@contextmanager
def house_style() -> Iterator[None]:
    """Figures as every page has them, whatever the user's rcParams are."""
    with mpl.rc_context():
        mpl.rcdefaults()
        yield


def series(index: int) -> dict[str, Any]:
    """Colour and dash of the index-th of several lines."""
    return {"color": _SERIES[index % len(_SERIES)], "linestyle": _DASHES[index % len(_DASHES)]}


def points(index: int) -> dict[str, Any]:
    """Colour and marker of the index-th of several sets of points."""
    return {"color": _SERIES[index % len(_SERIES)], "marker": _MARKERS[index % len(_MARKERS)]}


def blank(width: float, height: float | None = None, layout: Literal["constrained"] | None = None) -> Shown:
    """A figure without axes; width and height in inches, the width that the caller asked for before this one; square
    without a height."""
    wide = _WISH.get().width or width
    return Shown(figsize=(wide, wide if height is None else height), layout=layout)


def refuse_given_axes(what: str) -> None:
    """Raise StyleError for axes of the caller's, which what makes its own cannot be drawn into."""
    if into_given_axes():
        raise StyleError(f"ax: {what} makes its own axes; give width=... or style=... instead")


def subplots(rows: int, columns: int, width: float, height: float, **kwargs: Any) -> tuple[Figure, NDArray[Any]]:
    """A figure that no global state keeps, and its axes (rows, columns); width and height in inches, the width that
    the caller asked for before these; or the caller's own axes.

    Raises StyleError for another number of axes than the figure has panels.
    """
    wish = _WISH.get()
    if wish.axes is not None:
        if len(wish.axes) != rows * columns:
            raise StyleError(f"ax: this figure has {rows * columns} panels, {len(wish.axes)} axes were given")
        figure = wish.axes[0].figure
        while not isinstance(figure, Figure):  # of a SubFigure
            figure = figure.figure
        return figure, np.array(wish.axes, dtype=object).reshape(rows, columns)
    if wish.stacked and rows == 1 and columns > 1 and not (kwargs.get("sharey") and "width_ratios" in kwargs):
        kwargs.pop("width_ratios", None)
        figure = blank(width, height * columns, "constrained")
        figure.one_label = bool(kwargs.get("sharey"))
        return figure, figure.subplots(columns, 1, squeeze=False, **kwargs).reshape(1, columns)
    figure = blank(width, height, "constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **kwargs)


def one_panel(width: float, height: float) -> tuple[Figure, Axes]:
    """:func:`subplots` of one panel."""
    figure, axes = subplots(1, 1, width, height)
    return figure, axes[0, 0]


def panels(
    count: int, columns: int, panel: tuple[float, float], margin: tuple[float, float], least: tuple[float, float],
    **kwargs: Any,
) -> tuple[Figure, list[Axes]]:  # fmt: skip
    """A figure of so many panels in rows; panel : inches of each; margin : beside all; least : of the figure."""
    columns = min(columns, count)
    rows = -(-count // columns)
    width, height = (
        max(n * each + beside, small) for n, each, beside, small in zip((columns, rows), panel, margin, least)
    )
    figure, axes = subplots(rows, columns, width, height, **kwargs)
    flat = list(axes.ravel())
    for ax in flat[count:]:
        ax.remove()
    return figure, flat[:count]


def into_given_axes() -> bool:
    """Is it drawn into axes of the caller's? Labels and keys then belong to these, not to the figure."""
    return _WISH.get().axes is not None


def on_phone() -> bool:
    """Is it the variant for a phone that is being made?"""
    return _WISH.get().stacked


def narrow() -> bool:
    """Has the figure that is being made little width?"""
    return (_WISH.get().width or NARROW) < NARROW


def literal(figure: Figure) -> Figure:
    """The figure with every text that is no formula, though it has dollar signs, shown as it stands.

    Names of tests and of their quantities come from files, and may hold what only resembles mathematics.
    """
    for text in figure.findobj(Text):
        if "$" in text.get_text() and text.get_parse_math():
            try:
                MathTextParser("path").parse(text.get_text())
            except ValueError:
                text.set_parse_math(False)
    return figure


def settle(figure: Figure) -> Figure:
    """The figure laid out once and for all: each file it is written to would else lay it out again."""
    figure.set_dpi(DPI)
    engine = figure.get_layout_engine()
    if engine is None:
        return literal(figure)
    with mpl.rc_context(RC):
        try:
            engine.execute(figure)
        except ValueError:  # of a text that only resembles mathematics
            engine.execute(literal(figure))
        if _labels_shortened(figure):
            engine.execute(figure)
        with mpl.rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
            figure.set_layout_engine(None)  # "none" would leave one in its place, for which every file is drawn twice
    return figure


def keep_labels(figure: Figure) -> None:
    """Labels beside their ticks and titles above them stay where a figure was drawn with them last, at its own
    resolution: each file would else look for their places anew."""
    for axes in figure.axes:
        axes._autotitlepos = False  # type: ignore[attr-defined]  # no public way keeps the titles' own letters
        for axis in (axes.xaxis, axes.yaxis):
            place = axis.label.get_transform().transform(axis.label.get_position())
            axis.set_label_coords(*axes.transAxes.inverted().transform(place))


def _labels_shortened(figure: Figure) -> bool:
    """Labels of axes that reach beyond the figure or into the next panel's, put into several lines: the layout asks
    only how thick they are."""
    changed = False
    for axes in figure.axes:
        for at, axis in enumerate((axes.xaxis, axes.yaxis)):
            label, ends = axis.label, axes.bbox.get_points()[:, at]
            first, last = label.get_window_extent().get_points()[:, at]
            middle, whole = 0.5 * (first + last), figure.bbox.get_points()[1, at]
            others = [x.bbox.get_points()[:, at] for x in figure.axes]
            alone = all(low < ends[1] and high > ends[0] for low, high in others)
            most = 2.0 * min(middle, whole - middle) if alone else BESIDE * (ends[1] - ends[0])
            text = label.get_text()
            if last - first > most > 0.0 and "$" not in text:
                letters = max(map(len, text.splitlines())) * most / (last - first)
                label.set_text(textwrap.fill(" ".join(text.split()), max(int(letters), 1)))
                changed = True
    return changed


def relabel(figure: Figure, units: Units) -> None:
    """Put a campaign's own units into every text of a figure that was drawn for N and mm."""
    if units.plain:
        return
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        text.set_text(units.said(text.get_text()))
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):  # labels of ticks are written anew at each drawing
            formatter = axis.get_major_formatter()
            if isinstance(formatter, FuncFormatter):
                axis.set_major_formatter(partial(_formatted, units, formatter))


def _formatted(units: Units, plain: FuncFormatter, x: float, at: int | None) -> str:
    return units.said(plain(x, at))


def save(figure: Figure, path: str | os.PathLike[str], dpi: int = 200) -> Path:
    """Write a figure as .svg, .pdf or .png, by the path's ending; whole or not at all.

    Raises StyleError for another ending.
    """
    path = Path(path)
    if path.suffix not in (".svg", ".pdf", ".png"):
        raise StyleError(f"{path}: a figure is written as .svg, .pdf or .png")
    path.parent.mkdir(parents=True, exist_ok=True)
    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix)
    with mpl.rc_context({"svg.fonttype": "none", "pdf.fonttype": 42}), replacing(path) as temporary:
        settle(figure).savefig(temporary, dpi=dpi, metadata=metadata)
    return path
