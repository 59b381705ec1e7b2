"""A figure as an <svg> of a page: what matplotlib writes, without what nobody sees.

matplotlib names every group, says the font of every letter and each point of a line to a millionth. A page of many
loops would so be too large to send.
"""

import io
import re
from pathlib import Path

import matplotlib as mpl
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from bayes_iwan.report.style import RC

_FONT = "'DejaVu Sans', 'Verdana', sans-serif"
#: names that nothing refers to, turns by nothing, the font that the whole <svg> has, space between elements
_SPARE = re.compile(
    rf'(?<=<g) id="[^"]*"| id="image[^"]*"| transform="rotate\(-0 [^"]*"|(?<=; )font-family: {_FONT}; |(?<=>)\s+(?=<)'
)
#: colours that the pages' style names
KNOWN = frozenset(
    re.findall(r"--c-(\w{6}):", (Path(__file__).parent / "templates" / "page.css").read_text(encoding="utf-8"))
)


def svg(figure: Figure, name: str, alt: str) -> Markup:
    """The figure as an <svg> element whose ids cannot clash with another figure's, coordinates to 0.1 pt.

    Colours that the page's style names become its variables, so that they follow a dark screen; a figure with others
    (a colour scale) stays as it is, on a white card.
    """
    buffer = io.StringIO()
    with mpl.rc_context({**RC, "svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    head, _, text = buffer.getvalue().partition("</metadata>")
    box = re.findall(r'viewBox="([^"]*)"', head)[0]
    text = _SPARE.sub("", text)
    text = re.sub(r' (x|y|width|height)="(-?\d+\.\d{2,})"', lambda m: f' {m[1]}="{float(m[2]):.1f}"', text)
    text = re.sub(r'(<path [^>]*?\bd=")([^"]*)', lambda m: m[1] + _path(m[2]), text)  # not in a name that is shown
    card = 'class="card" '
    if KNOWN.issuperset(re.findall(r"#([0-9a-f]{6})\b", text)):
        text, card = re.sub(r"#([0-9a-f]{6})\b", r"var(--c-\1)", text), ""
    start = (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" viewBox="{box}" '
        f'style="font-family: {_FONT}" {card}role="img" aria-labelledby="{name}-title">'
        f'<title id="{name}-title">{escape(alt)}</title>'
    )
    return Markup(start + text)


def _path(text: str) -> str:
    """A path, a command a line, as steps from point to point; points to 0.1 pt, so that no error adds up."""
    out, at, first = "", [0, 0], [0, 0]
    for kind, *numbers in map(str.split, text.splitlines()):
        tenths = [round(10.0 * float(x)) for x in numbers]
        if kind == "L":
            steps = [x - before for x, before in zip(tenths, at)]
            out += "l" + _said(steps) if any(steps) else ""
        else:
            out += kind + _said(tenths)
        at = tenths[-2:] or first
        first = at if kind == "M" else first
    return out


def _said(tenths: list[int]) -> str:
    return " ".join(f"{x / 10:g}" for x in tenths).replace(" -", "-")
