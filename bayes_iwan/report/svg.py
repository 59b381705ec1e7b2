"""A figure as an <svg> of a page: what matplotlib writes, without what nobody sees.

matplotlib names every group, says the font of every letter and each point of a line to a millionth. A page of many
loops would so be too large to send.
"""

import base64
import io
import re
from pathlib import Path
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
from markupsafe import Markup, escape
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from bayes_iwan.report.style import RC

_SVG, _XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
_HREF = f"{{{_XLINK}}}href"
ElementTree.register_namespace("xlink", _XLINK)
_FONT = "'DejaVu Sans', 'Verdana', sans-serif"
#: greys of an embedded picture of thin lines
LEVELS = 16
#: colours that the pages' style names
KNOWN = frozenset(
    re.findall(r"--c-(\w{6}):", (Path(__file__).parent / "templates" / "page.css").read_text(encoding="utf-8"))
)
CARD = 'class="card" '


def svg(figure: Figure, name: str, alt: str) -> Markup:
    """The figure as an <svg> element whose ids cannot clash with another figure's, coordinates to 0.1 pt.

    Colours that the page's style names become its variables, so that they follow a dark screen; a figure with others
    (a colour scale) stays as it is, on a white card.
    """
    buffer = io.StringIO()
    with mpl.rc_context({**RC, "svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    root = _lean(ElementTree.fromstring(buffer.getvalue()), name)
    box = root.get("viewBox")
    text = "".join(ElementTree.tostring(child, encoding="unicode") for child in root)
    text = text.replace(f' xmlns:xlink="{_XLINK}"', "")
    used = set(re.findall(r"#([0-9a-f]{6})\b", text))
    if used <= KNOWN:
        text = re.sub(r"#([0-9a-f]{6})\b", r"var(--c-\1)", text)
    start = (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="{_XLINK}" viewBox="{box}" style="font-family: {_FONT}" '
        f'{"" if used <= KNOWN else CARD}role="img" aria-labelledby="{name}-title">'
        f'<title id="{name}-title">{escape(alt)}</title>'
    )
    return Markup(start + text + "</svg>")


def _lean(root: ElementTree.Element, name: str) -> ElementTree.Element:
    """What is drawn, and no more."""
    for child in root.findall(f"{{{_SVG}}}metadata"):
        root.remove(child)
    whole = ElementTree.tostring(root, encoding="unicode")
    meant = dict.fromkeys(re.findall(r"(?:href=\"|url\()#([^\")]+)", whole))
    ids = {x: f"{name}-{i}" for i, x in enumerate(meant)}
    for element in root.iter():
        element.tag = element.tag.removeprefix(f"{{{_SVG}}}")
        own = element.attrib
        if called := ids.get(own.pop("id", "")):
            own["id"] = called
        for key, value in own.items():
            if key == _HREF and value.startswith("#"):
                own[key] = f"#{ids[value[1:]]}"
            else:
                own[key] = re.sub(r"(?<=url\(#)[^)]+", lambda m: ids[m.group(0)], value)
        for key in {"x", "y", "width", "height"} & set(own):
            own[key] = re.sub(r"-?\d+\.\d{2,}", lambda m: f"{float(m.group(0)):.1f}", own[key])
        if "d" in own:
            own["d"] = _path(own["d"])
        if own.get("transform", "").startswith("rotate(-0 "):
            del own["transform"]
        if "style" in own:
            own["style"] = own["style"].replace(f"font-family: {_FONT}", "").replace("; ;", ";").strip("; ")
        if element.tag == "image":
            own[_HREF] = _few_colours(own[_HREF])
        element.tail = None
        if element.text is not None and not element.text.strip():
            element.text = None
    return root


def _few_colours(link: str) -> str:
    """An embedded picture of thin grey lines, with a palette."""
    out = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(link.partition(",")[2]))) as picture:
        picture.quantize(LEVELS, method=Image.Quantize.FASTOCTREE).save(out, "png", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(out.getvalue()).decode()}"


def _path(text: str) -> str:
    """A path of steps from point to point; points to 0.1 pt, so that no error adds up, and no more of them along a line
    than keep it within 0.1 pt of where it was: a page of loops is a third as large."""
    out, at, first = "", (0, 0), (0, 0)
    for run in re.findall(r"(?:L[^MLQCz]*)+|[MQCz][^MLQCz]*", text):
        tenths = [round(10.0 * float(x)) for x in re.sub("[MLQCz]", " ", run).split()]
        if run[0] == "L":
            line = np.array([*at, *tenths]).reshape(-1, 2)
            steps = np.diff(line[_corners(line)], axis=0).ravel()
            out += "l" + " ".join(_tenths(int(x)) for x in steps)
        else:
            out += run[0] + " ".join(map(_tenths, tenths))
        at = (tenths[-2], tenths[-1]) if tenths else first
        first = at if run[0] == "M" else first
    return out.replace(" -", "-")


def _corners(line: NDArray[np.int64]) -> NDArray[np.int64]:
    """Which points (n, 2) of a line make another line no more than 1 off (Douglas & Peucker, Cartographica 10, 1973,
    112)."""
    kept, parts = {0, len(line) - 1}, [(0, len(line) - 1)]
    while parts:
        first, last = parts.pop()
        if last - first < 2:
            continue
        chord, there = line[last] - line[first], line[first + 1 : last] - line[first]
        length = float(np.hypot(*chord))
        along = np.clip(there @ chord / max(length, 1e-9), 0.0, length)
        off = np.hypot(*(there - along[:, None] * (chord / max(length, 1e-9))).T)
        worst = int(np.argmax(off))
        if off[worst] > 1.0:
            kept.add(first + 1 + worst)
            parts += [(first, first + 1 + worst), (first + 1 + worst, last)]
    return np.array(sorted(kept))


def _tenths(x: int) -> str:
    whole, part = divmod(abs(x), 10)
    return ("-" if x < 0 else "") + (f"{whole or ''}.{part}" if part else f"{whole}")
