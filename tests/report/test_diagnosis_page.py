"""The diagnosis page: stands alone, leads with the answer, shows the gap as a sum, and holds up when parts are missing,
names are hostile or forces are torques."""

from __future__ import annotations

import html
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

import bayes_iwan as bi
from bayes_iwan.campaign.loops.clipping import limits_of_loops
from bayes_iwan.campaign.recording.units import Units
from bayes_iwan.diagnosis.answer.localisation import Statistic
from bayes_iwan.diagnosis.answer.next_test import NextTest
from bayes_iwan.diagnosis.assessment.budget import Kind, OneOf
from bayes_iwan.diagnosis.assessment.sampled_fit import Sampling
from bayes_iwan.diagnosis.fits.data import TREND_HARMONICS
from bayes_iwan.diagnosis.fits.gap_size import gap_power_N2
from bayes_iwan.diagnosis.fits.residuals import ALONG
from bayes_iwan.files import RECORD
from bayes_iwan.report.diagnosis import diagnosis_files, diagnosis_page, gap_figures
from bayes_iwan.report.diagnosis.diagnosis_page import write_diagnosis_page
from bayes_iwan.report.diagnosis.gap_figures import GapPictures
from bayes_iwan.report.page import provenance

from .layout import Outline

pytestmark = pytest.mark.usefixtures("no_figure_files")

T, N = 4, 64
PHASE = np.arange(N) / N


def pictures(times=1, blocks=3):
    """Four tests, each so many times, whose velocity-phase force is missed, the more the later the test."""
    size = np.tile(0.1 * np.arange(1, T + 1), times)
    f, a = np.tile([5.0, 5.0, 30.0, 30.0], times), np.tile([0.3, 1.0, 0.3, 1.0], times)
    wave = np.sin(2 * np.pi * PHASE)
    quadrature = np.zeros((len(size), 8))
    quadrature[:, 1] = size
    record = [SimpleNamespace(frequency_hz=x, amplitude_mm=y, clock=True) for x, y in zip(f, a)]
    statistics = {
        "region": (
            Statistic("region", "rising displacement", 0.1, 0.09, 0.11, 0.5, 0.5, 0.001, True),
            Statistic("region", "near the lower end", 0.02, 0.0, 0.03, 0.05, 0.3, 0.4, False),
        ),
    }
    return GapPictures(
        loops=tuple(
            SimpleNamespace(
                record=r, extras={}, displacement_mm=y * wave, force_N=5 * y * wave + np.cos(2 * np.pi * PHASE)
            )
            for r, y in zip(record, a)
        ),
        where=SimpleNamespace(
            frequency_hz=f,
            amplitude_mm=a,
            clock=True,
            phase_N=size[:, None] * np.cos(2 * np.pi * PHASE),
            expected_N=np.full((len(size), N), 0.01),
            sticking=0.5 + 0.5 * np.cos(4 * np.pi * PHASE) * np.ones((len(size), 1)),
            in_phase_N=np.zeros((len(size), 8)),
            quadrature_N=quadrature,
            expected_harmonic_N=np.full((len(size), 8), 0.01),
            stands_out=[t > 0 for t in range(len(size))],
            of=statistics.__getitem__,
        ),
        size=SimpleNamespace(
            tests=[SimpleNamespace(rms_N=x / np.sqrt(2), low_N=0.6 * x, high_N=0.8 * x) for x in size],
            friction_N=np.ones(len(size)),
            cycle=(np.array([2.0, 8.0, 14.0])[:blocks],) * len(size),
            along_N=tuple(np.full(blocks, s) for s in size),
            along_low_N=tuple(np.full(blocks, 0.9 * s) for s in size),
            along_high_N=tuple(np.full(blocks, 1.1 * s) for s in size),
        ),
    )


@pytest.fixture(scope="module")
def found(kit):
    """A dashpot on the virtual rig, one test held out."""
    return kit.diagnosed("viscous_damping", "held out")


@pytest.fixture(scope="module")
def nothing(kit):
    return kit.diagnosed(None)


def drawn_figures(found):
    return {name: draw() for name, draw in diagnosis_files.figures_of_diagnosis(found).items()}


@pytest.fixture(scope="module")
def figures(found):
    return drawn_figures(found)


def answer(found, kind=None, **rest):
    """A diagnosis as if the verdict had been another, with other figures of what is unexplained."""
    if kind is not None:
        causes = () if kind == "unknown" else found.verdict.causes
        flagged = kind in ("partly_explained", "unknown")
        verdict = replace(found.verdict, kind=Kind(kind), causes=causes, unknown_cause=flagged)
        found = replace(found, verdict=verdict, moved={} if kind == "unknown" else found.moved)
    return replace(found, budget=replace(found.budget, unexplained=replace(found.budget.unexplained, **rest)))


def read(path):
    text = path.read_text()
    return text, Outline(text)


def rows_of(text, caption):
    """Cells of the table with this caption, row by row, as a reader sees them; None where there is no such table."""
    tables = [t for t in re.findall(r"<table.*?</table>", text, re.S) if f">{caption}</caption>" in t]
    if not tables:
        return None
    rows = re.findall(r"<tr.*?</tr>", tables[0], re.S)[1:]
    return [
        [html.unescape(re.sub(r"<[^>]+>", "", c)).strip() for c in re.findall(r"<t[hd].*?</t[hd]>", r, re.S)]
        for r in rows
    ]


def percent(cell):
    return float(cell.removesuffix(" %").replace("−", "-"))


def test_page_stands_alone_and_leads_with_the_answer(tmp_path, found, figures, monkeypatch):
    monkeypatch.setattr(diagnosis_page, "where_sentences", lambda where: ["It grows with <frequency>."])
    odd = replace(found, campaign=replace(found.campaign, name="a <rope> & spring"))
    made = provenance(found.campaign, found.seed)
    text, parts = read(write_diagnosis_page(odd, figures, tmp_path / "diagnosis.html", made))
    assert parts.outside == [] and parts.open == []
    assert len(parts.ids) == len(set(parts.ids))
    assert parts.titles[:3] == ["Answer", "Where the model misses", "Which cause"]
    said = text.index("<br>".join(html.escape(s, quote=False).replace("'", "&#39;") for s in odd.sentences()))
    assert said < text.index("<svg") < text.index("It grows with")  # sentences, then one picture, then the rest
    assert "a &lt;rope&gt; &amp; spring" in text and "<rope>" not in text and "<frequency>" not in text
    damping = found.parameters["viscous_damping"]["c_N_s_mm"].mean
    for told in (f"{damping:.3g}", "seed 1", f"{found.where.count} statistics", "displacement channel", "Remedy"):
        assert told in text, told
    assert text.count("<figure>") == len(figures) and text.count('class="picture phone"') == len(figures)
    assert set(figures) >= {"headline", "shares", "moved", "before_after", "probabilities"}


def test_the_gap_stands_as_a_sum(tmp_path, found):
    own = found.verdict.probabilities
    probabilities = own | dict.fromkeys(found.search.effects, 0.0) | {"viscous_damping": own["viscous_damping"]}
    d = replace(found, verdict=replace(found.verdict, probabilities=probabilities | {"channel_delay": 0.2}))
    text, _ = read(write_diagnosis_page(d, {}, tmp_path / "diagnosis.html"))
    *causes, rest = rows_of(text, "The gap as a sum")
    assert [row[0] for row in causes] == ["viscous damping"] and rest[0] == "unexplained"
    assert percent(causes[0][2]) + percent(rest[2]) == pytest.approx(100.0, abs=0.6)
    low, high = (percent(x) for x in causes[0][3].split(" to "))
    assert low <= percent(causes[0][2]) <= high
    assert percent(causes[0][4]) == pytest.approx(100 * found.verdict.causes[0].held_out.value, abs=0.6)
    assert float(causes[0][1]) == pytest.approx(found.verdict.probabilities["viscous_damping"], abs=0.006)
    considered = rows_of(text, "Considered, not named")
    assert [row[0] for row in considered] == ["a delay between the channels"]


def test_where_the_gap_sits_is_said_once_where_nothing_is_named(tmp_path, found):
    """It is the whole gap's place then, which the next section tells."""
    d = answer(found, "unknown", probability=0.8, where=("Most near the upper end.",))
    text, _ = read(write_diagnosis_page(d, {}, tmp_path / "diagnosis.html"))
    assert "Where the unexplained part sits" not in text and "Where the model misses" in text


def test_a_rest_without_a_name_is_said_with_where_it_sits(tmp_path, found):
    d = answer(found, "partly_explained", probability=0.8, where=("Most near the <upper> end.",))
    text, _ = read(write_diagnosis_page(d, {}, tmp_path / "diagnosis.html"))
    assert rows_of(text, "The gap as a sum")[-1][:2] == ["unexplained, cause unknown", "0.80"]
    assert "Where the unexplained part sits" in text and "Most near the &lt;upper&gt; end." in text
    assert "(probability 0.80 that it has a cause of its own)" in text


@pytest.mark.parametrize(
    "kind, mark, following",
    [("none", "good", "No further test is needed."), ("unknown", "warning", "No known effect is left for a test")],
)
def test_page_without_a_named_cause(tmp_path, found, nothing, kind, mark, following):
    d = replace(nothing, edges=(), imitations=()) if kind == "none" else answer(found, kind)
    d = replace(d, next_test=None)
    assert d.verdict.kind == kind
    text, parts = read(write_diagnosis_page(d, {}, tmp_path / "diagnosis.html"))
    assert parts.open == [] and "No effect is named" in text and following in text
    assert re.search(r'<p class="(good|note|warning)">', text)[1] == mark
    assert rows_of(text, "The gap as a sum") is None and "No effect is named." in text
    assert "nan" not in re.findall(r"\w+", text) and "None," not in text


def test_what_the_numbers_rest_on_is_said(tmp_path, found):
    """A quick run, draws that converged, and draws that did not: on the page, and the last among the sentences."""

    def said(sampling):
        d = replace(found, sampling=sampling)
        text, _ = read(write_diagnosis_page(d, {}, tmp_path / "diagnosis.html"))
        return html.unescape(text), " ".join(d.sentences())

    page, sentences = said(None)
    assert "a quick run draws no samples" in page and "draws behind" not in sentences
    page, sentences = said(Sampling(True, "targets met", 812.4, 1.0042))
    assert "converged. At least 812 effective draws, R-hat at most 1.004." in page and "draws behind" not in sentences
    page, sentences = said(Sampling(False, "not converged: the time budget; bulk ESS of kp is 44 < 400", 44.0, 1.08))
    assert "have not converged" in page and "R-hat at most 1.080" in page
    assert "with care: the time budget; bulk ESS of kp is 44 < 400." in sentences
    page, _ = said(Sampling(False, "no draws within 45 s", None, None))
    assert "with care: no draws within 45 s.<" in page


def test_a_bench_advice_comes_before_a_test_that_would_not_help(tmp_path, found):
    bench = "one common signal into both channels"
    d = replace(found, next_test=NextTest(40.0, 1.0, 20, ("viscous_damping", "channel_delay"), 0.4, bench))
    text, _ = read(write_diagnosis_page(d, {}, tmp_path / "diagnosis.html"))
    assert text.index("One common signal") < text.index("No loop test that this rig can run separates")


def test_a_test_for_one_effect_separates_it_from_nothing(tmp_path, found):
    d = replace(found, next_test=NextTest(40.0, 1.0, 20, ("viscous_damping", "none"), 0.4, "a pause"))
    text, _ = read(write_diagnosis_page(d, {}, tmp_path / "diagnosis.html"))
    assert "can run tells whether there is viscous damping well: the best of them would change its odds by" in text


def test_a_gap_that_noise_hides_is_no_number_and_nothing_removes_more_than_can_be_removed(tmp_path, found):
    """Pages of sound specimens said "0.00000176 mN", and one a ceiling of 53 % beside an effect that removes all."""
    b, page = found.budget, tmp_path / "diagnosis.html"
    hidden = {"rms_N": 1.8e-9, "low_N": 0.0}
    text, _ = read(write_diagnosis_page(replace(found, budget=replace(b, after=replace(b.after, **hidden))), {}, page))
    assert "RMS without and nothing beyond noise with all named effects" in text
    assert re.search(r"No effect can be expected to remove\s+more than 100 % of the gap", text)
    groups = (OneOf(("friction_fade", "spring_softening"), 0.9, 0.998),)
    assert diagnosis_page.ceiling_shrink(found) < 0.998
    assert diagnosis_page.ceiling_shrink(replace(found, verdict=replace(found.verdict, one_of=groups))) == 0.998
    sound = replace(found, budget=replace(b, before=replace(b.before, **hidden)))
    text, _ = read(write_diagnosis_page(sound, {}, page))
    assert "there is no gap to shrink" in text and "mN with all" not in text


def test_records_of_one_block_of_cycles_show_no_change_along_them(found):
    """Three cycles a level; a gap of a rounding error may be larger along the records than in the loops."""
    loop, data = found.residual.data.loops[0], SimpleNamespace
    one = replace(loop, block_cycle=loop.block_cycle[:1])
    before = data(along=data(rms_N=1e-12), loop=data(rms_N=0.0))
    changing = data(before=before, residual=data(data=data(loops=(one, one))))
    assert diagnosis_files._changing(changing, ("a", "b")) == ()


def test_unknown_numbers_read_as_a_dash(tmp_path, found):
    numbers = found.parameters["viscous_damping"]
    parameters = {"viscous_damping": numbers | {"c_N_s_mm": replace(numbers["c_N_s_mm"], sd=float("nan"))}}
    causes = (replace(found.verdict.causes[0], held_out=None),)
    d = replace(found, verdict=replace(found.verdict, causes=causes), parameters=parameters)
    text, _ = read(write_diagnosis_page(d, {}, tmp_path / "diagnosis.html"))
    assert rows_of(text, "The gap as a sum")[0][4:6] == ["–", "–"]
    assert "None" not in re.sub(r"“None”", "", text)


def bars(axes):
    """Left end, width and text beside each bar, by the bar's label, from the top."""
    at = {round(float(t)): x.get_text() for t, x in zip(axes.get_yticks(), axes.get_yticklabels())}
    texts = {round(float(t.xy[1])): t.get_text() for t in axes.texts}
    return {
        at[round(b.get_y() + b.get_height() / 2)]: (b.get_x(), b.get_width(), texts[round(b.get_y() + 0.31)])
        for b in axes.patches
    }


def test_the_waterfall_falls_from_the_gap_to_the_rest(found, figures):
    share, rest = found.verdict.causes[0].share.value, found.budget.unexplained.share.value
    shown = bars(figures["headline"].axes[0])
    assert list(shown) == ["gap", "viscous damping", "unexplained", "noise"]
    assert shown["gap"][:2] == (0.0, 1.0)
    left, width, text = shown["viscous damping"]
    assert (left + width, width) == pytest.approx((1.0, share)) and text.startswith(f"{100 * share:.0f} %  (")
    assert shown["unexplained"][:2] == pytest.approx((0.0, rest))
    some = (OneOf(("end_stop", "free_play", "mains_interference"), 0.9, 0.5 * rest),)
    flagged = replace(found.budget, unexplained=replace(found.budget.unexplained, probability=0.9))
    shown = bars(
        drawn_figures(replace(found, budget=flagged, verdict=replace(found.verdict, one_of=some)))["headline"].axes[0]
    )
    assert list(shown) == ["gap", "viscous damping", "unexplained", "of it one of: end stop\nor 2 others", "noise"]
    assert shown["of it one of: end stop\nor 2 others"][:2] == pytest.approx((0.5 * rest, 0.5 * rest))


def test_noise_above_the_gap_is_told_as_it_is(nothing):
    before = replace(nothing.budget.before, rms_N=nothing.budget.before.noise_N / 3)
    shown = bars(drawn_figures(replace(nothing, budget=replace(nothing.budget, before=before)))["headline"].axes[0])
    assert list(shown) == ["gap", "unexplained", "noise"] and shown["noise"][2] == "300 %, longer than shown"


def test_the_headline_shows_the_worst_test_with_and_without_the_cause(found, figures):
    right = figures["headline"].axes[1]
    lines = {x.get_label(): x.get_ydata() for x in right.lines}
    alone, left = lines["model alone"], lines["with viscous damping"]
    worst = int(np.argmax([t.rms_N for t in found.before.tests]))
    np.testing.assert_array_equal(alone, found.where.phase_N[worst])
    assert np.sqrt(np.mean(left**2)) < 0.2 * np.sqrt(np.mean(alone**2))


def test_a_gap_that_changes_along_the_record_is_shown_at_its_ends(found):
    along = replace(found.before.along, rms_N=2.0 * found.before.loop.rms_N)
    ends = drawn_figures(replace(found, before=replace(found.before, along=along)))["headline"].axes[1:]
    assert len(ends) == 2 and "cycles 1 to" in ends[0].get_title(loc="left")
    test = int(np.argmax(gap_power_N2(found.residual, (ALONG,))))
    loop = found.residual.data.loops[test]
    assert ends[1].get_title(loc="left").endswith(f"to {round(loop.n_cycles)}")
    drawn = [dict((x.get_label(), x.get_ydata()) for x in ax.lines)["model alone"] for ax in ends]
    # what both ends have in common is the averaged loop's; what differs is what the cycles themselves differ by
    low = slice(0, TREND_HARMONICS + 1)
    differ = loop.block_harmonics_N[0, low] - loop.block_harmonics_N[-1, low]
    phase = np.arange(len(drawn[0])) / len(drawn[0])
    want = (differ @ np.exp(2j * np.pi * np.outer(np.arange(len(differ)), phase))).real
    np.testing.assert_allclose(drawn[0] - drawn[1], want, atol=1e-6)


def test_a_clipped_record_is_said_beside_the_verdict(found):
    assert not any("clipped" in s for s in found.sentences())
    first, *others = found.data.loops
    low = 0.9 * float(first.record.force_N.max())
    clipped = replace(first, record=replace(first.record, force_N=np.minimum(first.record.force_N, low)))
    loops = (clipped, *others)
    limits = limits_of_loops([x.record for x in loops], loops)
    again = replace(found, data=replace(found.data, loops=loops), clipped=limits)
    (said,) = (s for s in again.sentences() if "clipped" in s)
    assert first.file in said and "Raise the force range" in said and f"1 of {1 + len(others)} tests" in said


def test_labels_of_ticks_keep_apart():
    assert gap_figures._apart([0.3, 0.31, 0.6, 0.9, 0.95]) == [0.3, 0.6, 0.95]
    assert gap_figures._apart([8.0, 14.0, 22.0]) == [8.0, 14.0, 22.0]
    assert gap_figures._apart([5.0]) == [5.0] and gap_figures._apart([5.0, 5.1]) == [5.0, 5.1]


def test_figures_show_what_they_are_given(found, figures):
    probable = figures["probabilities"].axes[0]
    labels = [x.get_text() for x in probable.get_yticklabels()]
    assert labels[0] == "viscous damping" and any("unknown" in x for x in labels) and any("none" in x for x in labels)
    assert max(b.get_width() for b in probable.patches) == found.verdict.probabilities["viscous_damping"]
    drawn = {name: draw() for name, draw in gap_figures.figures_of_gap(pictures()).items()}
    loops = drawn["gap_loops"].axes
    assert sum(bool(ax.collections) and ax.get_title(loc="left") != "" for ax in loops) == T
    colours = loops[T - 1].collections[0].get_colors()
    top, bottom = colours[0], colours[N // 2]
    assert top[0] > top[2] and bottom[2] > bottom[0]  # red where measured is above the model, else blue
    cells = drawn["gap_map"].axes[1].collections[0].get_array()
    assert cells.size == T * N and abs(float(cells.max())) == pytest.approx(40.0)
    stems = drawn["gap_harmonics"].axes
    assert stems[1].get_ylim()[1] > 0.4


def test_a_diagnosis_of_torque_over_angle_speaks_of_no_newtons(tmp_path, found, figure_files):
    """The same numbers as a torque in N·m over an angle in mrad: no text of page, figures or answer says N or mm."""
    records = tuple(replace(r, units=Units("mrad", "N·m")) for r in found.campaign.tests)
    torsion = replace(found, campaign=replace(found.campaign, tests=records))
    page = bi.write(torsion, tmp_path / "out").read_text()
    page = re.sub(r"<(script|style)\b.*?</\1>", " ", page, flags=re.S)
    texts = [html.unescape(re.sub(r"<[^>]+>", " ", page)), "\n".join(torsion.sentences())]
    for text in texts:
        foreign = re.search(r"(?<![\w·])(?:[km]?N(?!·m|\w)|mm(?!\w))|\w_(?:N|mm)(?:_\w+)?(?![\w.])", text)
        assert foreign is None, text[max(foreign.start() - 60, 0) : foreign.end() + 40]
    assert "N·m RMS" in texts[1] and "N·m·s/mrad" in texts[1]
    assert bi.plot.gap(torsion).axes[1].get_ylabel() == "measured − model (N·m)"
    assert sorted(x.name for x in (tmp_path / "out").iterdir()) == [
        "diagnosis.html",
        "diagnosis.json",
        "figures",
        "fits.json",
        RECORD,
    ]


def test_a_run_that_is_killed_over_an_older_one_leaves_no_answer_beside_another_page(tmp_path, found, monkeypatch):
    monkeypatch.setattr(diagnosis_files, "figures_of_diagnosis", lambda found: {})
    out = tmp_path / "out"
    bi.write(found, out)
    assert {"diagnosis.json", "diagnosis.html", "fits.json"} <= {x.name for x in out.iterdir()}

    def killed(*a, **k):
        raise KeyboardInterrupt

    monkeypatch.setattr(diagnosis_files, "write_diagnosis_page", killed)
    with pytest.raises(KeyboardInterrupt):
        bi.write(found, out)
    assert not [x.name for x in out.iterdir() if x.suffix in (".json", ".html") and x.name != RECORD]


def test_one_figure_of_a_diagnosis_takes_style_width_and_axes(found):
    assert bi.plot.gap(found, width="column").get_size_inches()[0] == pytest.approx(3.5)
    own = Figure()
    assert bi.plot.gap(found, "probabilities", ax=own.subplots(), style={"lines.linewidth": 7.0}) is own
    with pytest.raises(ValueError, match='no figure "nothing"'):
        bi.plot.gap(found, "nothing")


def test_many_tests_and_single_blocks_draw():
    drawn = gap_figures.figures_of_gap(pictures(times=6, blocks=1))
    assert "gap_cycles" not in drawn and len(drawn["gap_loops"]().axes) == 6 * T + 1


def test_figure_files(tmp_path, found, figures, figure_files):
    write_diagnosis_page(found, {"moved": figures["moved"]}, tmp_path / "diagnosis.html")
    assert sorted(x.name for x in (tmp_path / "figures").iterdir()) == ["diagnosis_moved.pdf", "diagnosis_moved.png"]
    assert (tmp_path / "figures" / "diagnosis_moved.png").read_bytes()[:4] == b"\x89PNG"
