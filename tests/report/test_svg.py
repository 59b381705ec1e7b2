"""A figure on a page is what matplotlib draws, in fewer characters."""

import base64
import io
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from bayes_iwan.report import style
from bayes_iwan.report.style import subplots
from bayes_iwan.report.svg import KNOWN, _path, svg


def points_of(path):
    steps = np.array([float(x) for x in re.findall(r"-?\d+\.?\d*", path)]).reshape(-1, 2)
    return np.cumsum(steps, axis=0)


@pytest.mark.parametrize("kind", ["wild", "ellipse", "straight"])
def test_a_path_stays_where_it_was(kind):
    angle = np.linspace(0.0, 2.0 * np.pi, 400)
    points = {
        "wild": np.cumsum(np.random.default_rng(3).normal(0.0, 3.0, (400, 2)), axis=0),
        "ellipse": np.stack([80.0 * np.cos(angle), 60.0 * np.sin(angle)], axis=1),
        "straight": np.stack([40.0 * angle, 30.0 * angle], axis=1),
    }[kind]
    path = "".join(f"{'L' if i else 'M'} {x:.6f} {y:.6f} \n" for i, (x, y) in enumerate(points))
    np.testing.assert_allclose(points_of(_path(path)), points, atol=0.05 + 1e-9)


def test_lines_go_on_where_other_parts_of_a_path_end():
    assert _path("M 1 2\nL 3 4\nQ 3 5 4 5\nL 4 6\nz\nM 0 0\nL 1.04 0") == "M1 2l2 2Q3 5 4 5l0 1zM0 0l1 0"


def test_what_is_seen_stays_and_names_of_two_figures_do_not_clash():
    figure, axes = subplots(1, 2, 4, 2)
    x = np.linspace(0.0, 1.0, 200)
    axes[0, 0].plot(x, np.sin(6.0 * x), color="#9A9A9A", rasterized=True)
    axes[0, 1].plot(x, np.cos(6.0 * x), "o-", label="$α_1$ of one")
    axes[0, 1].barh([0.5], [0.5], hatch="//", color="#56B4E9", edgecolor="#123456")
    axes[0, 1].legend()
    axes[0, 1].set_ylabel("force (N)")
    one, other = (str(svg(figure, name, "two lines & more")) for name in ("one", "other"))
    names = []
    for text in (one, other):
        root = ElementTree.fromstring(text)
        ids = [e.get("id") for e in root.iter() if e.get("id")]
        meant = set(re.findall(r"(?:href=\"|url\()#([\w.-]+)", text))
        assert len(ids) == len(set(ids)) and meant <= set(ids)
        names += ids
        assert {"force (N)", "two lines & more"} <= {"".join(e.itertext()) for e in root.iter()}
        assert any("url(#" in e.get("style", "") for e in root.iter())  # the hatch
        assert "rotate(-90 " in text and "rotate(-0" not in text
    assert len(names) == len(set(names))
    picture = re.search(r"data:image/png;base64,([^\"]+)", one).group(1)
    with Image.open(io.BytesIO(base64.b64decode(picture))) as image:
        grey = np.asarray(image.convert("RGBA"))
    assert 0.001 < np.mean(grey[..., 3] > 128) < 0.2
    solid = grey[grey[..., 3] > 128][:, :3].astype(int)
    assert np.abs(solid - 0x9A).max() < 12


def test_colours_of_figures_follow_a_dark_screen():
    """One that the page's style does not name leaves its whole figure a white card there."""
    files = Path(style.__file__).parent.rglob("*.py")
    used = {x.lower() for path in files for x in re.findall(r'"#([0-9A-Fa-f]{6})"', path.read_text(encoding="utf-8"))}
    assert len(used) > 10 and used <= KNOWN
