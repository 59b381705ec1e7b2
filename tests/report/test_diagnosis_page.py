"""The diagnosis page: stands alone, leads with the answer, and holds up when parts are missing or names are hostile."""

from __future__ import annotations

import re
from html.parser import HTMLParser

import numpy as np
import pytest

from bayes_iwan.report import gap_figures
from bayes_iwan.report.diagnosis_page import write_diagnosis_page, write_figures

T, N = 4, 64
PHASE = np.arange(N) / N


def pictures(miss=0.1):
    """Four tests whose velocity-phase force is missed, the more the later the test."""
    size = miss * np.arange(1, T + 1)
    u = np.sin(2 * np.pi * PHASE) * np.array([0.3, 1.0, 0.3, 1.0])[:, None]
    residual = size[:, None] * np.cos(2 * np.pi * PHASE)
    harmonics = np.zeros((T, 8))
    quadrature = harmonics.copy()
    quadrature[:, 1] = size
    return {
        "names": [f"{f:g} Hz, {a:g} mm" for f in (5, 30) for a in (0.3, 1.0)],
        "frequency_hz": np.array([5.0, 5.0, 30.0, 30.0]),
        "amplitude_mm": np.array([0.3, 1.0, 0.3, 1.0]),
        "displacement_mm": u,
        "force_N": 5 * u + np.cos(2 * np.pi * PHASE),
        "residual_N": residual,
        "expected_N": np.full((T, N), 0.01),
        "sticking": 0.5 + 0.5 * np.cos(4 * np.pi * PHASE) * np.ones((T, 1)),
        "in_phase_N": harmonics,
        "quadrature_N": quadrature,
        "expected_harmonic_N": np.full((T, 8), 0.01),
        "gap_N": size / np.sqrt(2),
        "gap_low_N": 0.6 * size,
        "gap_high_N": 0.8 * size,
        "significant": np.array([False, True, True, True]),
        "friction_N": np.ones(T),
        "cycle": (np.array([2.0, 8.0, 14.0]),) * T,
        "along_N": tuple(np.full(3, s) for s in size),
        "along_low_N": tuple(np.full(3, 0.9 * s) for s in size),
        "along_high_N": tuple(np.full(3, 1.1 * s) for s in size),
        "regions": [
            ("rising displacement", 0.1, 0.09, 0.11, 0.5, 0.5, True),
            ("near the lower end", 0.02, 0.0, 0.03, 0.05, 0.3, False),
        ],
    }


def diagnosis(cause="viscous_damping"):
    moved = {"kp_N_mm": {"before": 5.0, "after": 5.5, "sd": 0.1, "unit": "N/mm"}}
    effect = {
        "name": "viscous_damping",
        "parameters": {"c_N_s_mm": {"mean": 0.00151, "sd": 0.0001, "unit": "N·s/mm"}},
        "log_evidence": 40.0,
        "gap_after_rms_N": 0.013,
        "shrink": 0.93,
        "shrink_interval": [0.9, 0.95],
        "shrink_held_out": 0.88,
        "gap_after_held_out_rms_N": 0.017,
        "moved": moved,
    }
    tests = [
        {
            "file": f"t{i}.csv",
            "frequency_hz": 5.0,
            "amplitude_mm": 1.0,
            "gap_rms_N": 0.1,
            "interval_N": [0.09, 0.11],
            "share": 0.05,
            "significant": i > 0,
        }
        for i in range(T)
    ]
    return {
        "schema": 1,
        "seed": 42,
        "quick": True,
        "campaign": "a <rope> & spring",
        "verdict": {
            "cause": cause,
            "probability": 0.93,
            "cannot_tell_apart": ["maxwell_branch"],
            "second_cause": None,
            "not_testable": ["series_compliance", "mains_hum"],
        },
        "probabilities": {"viscous_damping": 0.93, "maxwell_branch": 0.05, "none": 0.001, "unknown": 0.019},
        "gap": {
            "before_rms_N": 0.19,
            "before_interval_N": [0.18, 0.2],
            "before_share": 0.057,
            "noise_rms_N": 0.002,
            "after_rms_N": 0.01,
            "after_share": 0.003,
            "shrink": 0.95,
            "shrink_interval": [0.9, 0.97],
            "ceiling_shrink": 0.98,
            "held_out": None,
        },
        "where": {
            "tests": tests,
            "looks": 61,
            "sentences": ["It grows with <frequency>."],
            "regions": [
                {
                    "region": "gross slip",
                    "gap_rms_N": 0.2,
                    "share_of_gap": 0.8,
                    "share_of_time": 0.6,
                    "significant": True,
                }
            ],
            "harmonics": [{"order": 1, "in_phase_N": 0.01, "quadrature_N": 0.18, "significant": True}],
        },
        "effects": [effect],
        "next_test": {
            "frequency_hz": 60.0,
            "amplitude_mm": 1.2,
            "cycles": 40,
            "separates": ["viscous_damping", "maxwell_branch"],
            "expected_log_odds": 8.1,
            "bench": "",
        },
        "sentences": ["The model misses 0.19 N.", "The likeliest cause is viscous damping.", "Run 60 Hz at 1.2 mm."],
    }


@pytest.fixture(scope="module")
def figures():
    p, d = pictures(), diagnosis()
    out = gap_figures.figures_of_gap(p)
    out["headline"] = gap_figures.headline_figure(
        d["probabilities"],
        p["names"][3],
        p["residual_N"][3],
        p["expected_N"][3],
        0.05 * p["residual_N"][3],
        "viscous_damping",
    )
    out["probabilities"] = gap_figures.probabilities_figure(d["probabilities"], ["maxwell_branch"])
    out["before_after"] = gap_figures.before_after_figure(
        p["names"], p["residual_N"], 0.05 * p["residual_N"], p["expected_N"], "viscous_damping"
    )
    out["shrink"] = gap_figures.shrink_figure(
        [("viscous_damping", 0.93, 0.9, 0.95, 0.88), ("delay", 0.2, 0.1, 0.3, None)]
    )
    out["moved"] = gap_figures.moved_figure(d["effects"][0]["moved"])
    return out


class Parts(HTMLParser):
    """Opened and closed tags, ids, and links to anywhere else."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.outside: list[str] = []
        self.headings: list[str] = []

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if tag not in ("meta", "link", "br", "img", "input", "path", "use"):
            self.open.append(tag)
        if "id" in values:
            self.ids.append(values["id"])
        for key in ("src", "href", "xlink:href"):
            link = values.get(key) or ""
            if link and not link.startswith(("#", "data:")):
                self.outside.append(link)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_endtag(self, tag):
        if self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_data(self, data):
        if self.open and self.open[-1] == "h2":
            self.headings.append(data.strip())


def read(path):
    text = path.read_text()
    parts = Parts()
    parts.feed(text)
    return text, parts


def test_page_stands_alone_and_leads_with_the_answer(tmp_path, figures):
    d = diagnosis()
    about = {"viscous_damping": {"physics": "A force ∝ velocity.", "bench": "a spring"}}
    text, parts = read(write_diagnosis_page(d, figures, tmp_path / "diagnosis.html", about))
    assert parts.outside == [] and parts.open == []
    assert len(parts.ids) == len(set(parts.ids))
    assert parts.headings[:3] == ["Answer", "Where the model misses", "Which cause"]
    answer = text.index(" ".join(d["sentences"]))
    assert answer < text.index("<svg") < text.index("It grows with")  # sentences, then one picture, then the rest
    assert "a &lt;rope&gt; &amp; spring" in text and "<rope>" not in text and "<frequency>" not in text
    for told in (
        "series compliance and mains hum",
        "60 Hz at 1.2 mm",
        "0.00151",
        "88 %",
        "5.5",
        "seed 42",
        "61 looks",
        "displacement channel",
    ):
        assert told in text, told
    assert text.count("<svg") == len(figures)


@pytest.mark.parametrize("cause", ["none", "unknown"])
def test_page_without_a_named_cause(tmp_path, cause):
    d = diagnosis(cause) | {"effects": [], "next_test": None}
    d["verdict"] |= {"cannot_tell_apart": [], "not_testable": []}
    text, parts = read(write_diagnosis_page(d, {}, tmp_path / "diagnosis.html"))
    assert parts.open == [] and "No cause is named" in text and "None is needed" in text
    assert "nan" not in text and "None," not in text


def test_a_bench_advice_comes_before_a_test_that_would_not_help(tmp_path):
    d = diagnosis()
    d["next_test"] |= {"bench": "one common signal into both channels", "expected_log_odds": 0.4}
    text, _ = read(write_diagnosis_page(d, {}, tmp_path / "diagnosis.html"))
    assert text.index("one common signal") < text.index("No loop test separates")


def test_unknown_numbers_read_as_a_dash(tmp_path):
    d = diagnosis()
    d["effects"][0] |= {"shrink_held_out": None, "gap_after_held_out_rms_N": None, "shrink_interval": None}
    d["effects"][0]["parameters"]["c_N_s_mm"]["sd"] = None
    text, _ = read(write_diagnosis_page(d, {}, tmp_path / "diagnosis.html"))
    assert "None" not in re.sub(r"None is needed|“None”", "", text) and "–" in text


def test_figures_show_what_they_are_given(figures):
    bars = figures["probabilities"].axes[0]
    labels = [x.get_text() for x in bars.get_yticklabels()]
    assert labels[0] == "viscous damping" and any("unknown" in x for x in labels) and any("none" in x for x in labels)
    assert max(b.get_width() for b in bars.patches) == pytest.approx(0.93)
    loops = figures["gap_loops"].axes
    assert sum(bool(ax.collections) and ax.get_title(loc="left") != "" for ax in loops) == T
    colours = loops[T - 1].collections[0].get_colors()
    top, bottom = colours[0], colours[N // 2]
    assert top[0] > top[2] and bottom[2] > bottom[0]  # red where measured is above the model, else blue
    cells = figures["gap_map"].axes[1].collections[0].get_array()
    assert cells.size == T * N and abs(float(cells.max())) == pytest.approx(40.0)
    stems = figures["gap_harmonics"].axes
    assert stems[1].get_ylim()[1] > 0.4


def test_shrink_figure_leaves_out_what_is_not_known():
    unknown = float("nan")
    figure = gap_figures.shrink_figure([("a", unknown, unknown, unknown, None), ("b", 0.5, 0.4, 0.6, -3.0)])
    assert [x.get_text() for x in figure.axes[0].get_yticklabels()] == ["b"]


def test_many_tests_and_single_blocks_draw():
    p = pictures()
    many = {k: (np.concatenate([v] * 6) if isinstance(v, np.ndarray) else v) for k, v in p.items()}
    many["names"] = [f"test {i}" for i in range(6 * T)]
    for key in ("cycle", "along_N", "along_low_N", "along_high_N"):
        many[key] = tuple(x[:1] for x in p[key] * 6)
    drawn = gap_figures.figures_of_gap(many)
    assert "gap_cycles" not in drawn and len(drawn["gap_loops"].axes) == 6 * T + 1


def test_figure_files(tmp_path, figures):
    paths = write_figures({"moved": figures["moved"]}, tmp_path)
    assert sorted(x.name for x in paths) == ["moved.png", "moved.svg"]
    assert (tmp_path / "moved.png").read_bytes()[:4] == b"\x89PNG"
