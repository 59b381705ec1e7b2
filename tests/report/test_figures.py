"""Figures take a posterior and return a Figure: units on the axes, texts that do not overlap, and the truth in them."""

from __future__ import annotations

import inspect
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from bayes_iwan.comparison.frequencies import compare_frequencies
from bayes_iwan.models import embedded_error
from bayes_iwan.report.identification import law_figures, loops, marginals, predictive_checks, sampling, trends
from bayes_iwan.report.identification.by_frequency import alone_loops_figure
from bayes_iwan.report.identification.predictive import predict
from bayes_iwan.report.page import Page
from bayes_iwan.report.style import save

FIGURES = {
    "loops, friction": lambda p: loops.loops_figure(p, friction=True),
    "loops, total": lambda p: loops.loops_figure(p),
    "residuals": loops.residuals_figure,
    "paper's Fig. 3": loops.paper_fig3,
    "paper's Fig. 4": lambda p: loops.frequencies_figure(p, model=False),
    "paper's Fig. 8": law_figures.slip_density_figure,
    "paper's Fig. 9": law_figures.stiffness_figure,
    "paper's Fig. 10": law_figures.normal_force_figure,
    "paper's Fig. 12": loops.frequencies_figure,
    "prior and posterior": marginals.prior_posterior_figure,
    "corner": marginals.identifiable_corner,
    "paper's corner": lambda p: marginals.paper_corner(p, ["kp_N_mm", "ki_N_mm", "t1_N", "eta1"]),
    "trends": trends.trends_figure,
    "traces": sampling.traces_figure,
    "tau": sampling.tau_figure,
    "regions": predictive_checks.regions_figure,
    "LOO-PIT": predictive_checks.loo_pit_figure,
}


@pytest.fixture(scope="module")
def drawn(posterior):
    out = {}
    for name, make in FIGURES.items():
        figure = make(posterior)
        FigureCanvasAgg(figure).draw()
        out[name] = figure
    return out


@pytest.mark.parametrize("name", FIGURES)
def test_axes_say_what_they_show(drawn, name):
    figure = drawn[name]
    assert isinstance(figure, Figure)
    said = " ".join([t.get_text() for t in figure.findobj(Text)])
    if name not in ("traces", "regions", "LOO-PIT", "prior and posterior"):
        assert any(f"({unit})" in said for unit in ("N", "mm", "mJ", "N/mm", "1/N", "steps", "mJ/cycle")), said
    for ax in figure.axes:
        if ax.axison:
            assert len(ax.get_xticklabels()) <= 12
            assert len([t for t in ax.get_yticklabels() if t.get_text()]) <= 20


@pytest.mark.parametrize("name", FIGURES)
def test_tick_labels_do_not_overlap(drawn, name):
    for ax in drawn[name].axes:
        if not ax.axison:
            continue
        for axis, along in ((ax.xaxis, "x"), (ax.yaxis, "y")):
            # rotated labels' boxes may touch where the texts do not
            labels = [
                t for t in axis.get_ticklabels() if t.get_visible() and t.get_text() and not t.get_rotation() % 90
            ]
            low, high = sorted(axis.get_view_interval())
            boxes = [
                t.get_window_extent()
                for t in labels
                if low <= (t.get_position()[0] if along == "x" else t.get_position()[1]) <= high
            ]
            spans = sorted((b.x0, b.x1) if along == "x" else (b.y0, b.y1) for b in boxes)
            assert all(a[1] <= b[0] + 1.5 for a, b in pairwise(spans)), (name, [t.get_text() for t in labels])


def test_texts_stay_on_the_picture(drawn):
    for name, figure in drawn.items():
        width, height = figure.get_size_inches() * figure.dpi
        texts = [*figure.texts, *(t for legend in figure.legends for t in legend.get_texts())]
        for ax in figure.axes:
            texts += [ax.title, ax._left_title, ax.xaxis.label, ax.yaxis.label] if ax.axison else []
            texts += ax.get_legend().get_texts() if ax.get_legend() else []
        for text in texts:
            if text.get_visible() and text.get_text().strip():
                box = text.get_window_extent()
                assert box.x0 > -1 and box.y0 > -1 and box.x1 < width + 1 and box.y1 < height + 1, (name, text)


def test_bands_hold_the_measured_loop(posterior):
    p = predict(posterior, n=400)
    low, high = np.quantile(p.loop_N, [0.05, 0.95], axis=0)
    inside = np.mean((p.measured_N >= low) & (p.measured_N <= high))
    assert inside > 0.75  # the band counts an unknown place of rest (ZERO_FLOOR), which made loops do not have
    wide = np.quantile(p.cycle_N, 0.95, axis=0) - np.quantile(p.cycle_N, 0.05, axis=0)
    assert np.all(wide.mean(axis=1) > (high - low).mean(axis=1))


def test_replicates_have_no_unresolvable_harmonics(posterior):
    p = predict(posterior, n=50)
    noise = np.abs(np.fft.rfft(p.loop_N - p.force_N, axis=-1))
    for t, loop in enumerate(p.loops):
        resolved = np.isfinite(loop.noise_N[: noise.shape[2]])
        top = int(np.max(np.flatnonzero(resolved)))
        assert top < noise.shape[2] - 1
        assert np.max(noise[:, t, top + 1 :]) < 1e-9


def test_fig_9_is_the_stiffness_that_the_force_has(posterior, monkeypatch):
    """With the embedded model error: its exponent and Eq. (12) make up for each other, loops know what both give."""
    model = replace(posterior.problem.model, embedded=True)
    values = dict(posterior.parameter_values()) | dict.fromkeys(embedded_error.NAMES, np.zeros(posterior.log_prob.size))
    values[embedded_error.STIFFNESS_NAME] = np.full(posterior.log_prob.size, 0.2)
    monkeypatch.setattr(law_figures, "_posterior_values", lambda p: values)
    problem = replace(posterior.problem, model=model)
    figure = law_figures.stiffness_figure(replace(posterior, problem=problem), prior=False)
    alpha, k = figure.axes[0].lines[-1].get_data()
    law = model.stiffness_law.k(values, np.tile(alpha, (posterior.log_prob.size, 1, 1)))[:, 0]
    np.testing.assert_allclose(k[1:], np.median(law * alpha**0.2, axis=0)[1:], rtol=1e-6)


def test_files_vector_and_raster(posterior, tmp_path):
    figure = law_figures.slip_density_figure(posterior)
    assert save(figure, tmp_path / "a.svg").read_text().startswith("<?xml")
    assert save(figure, tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    assert save(figure, tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(x.name for x in tmp_path.iterdir()) == ["a.pdf", "a.png", "a.svg"]


def test_same_input_same_picture(posterior):
    pages = []
    for _ in range(2):
        page = Page("twice")
        page.section("one").figure(law_figures.normal_force_figure(posterior), "caption", "alt")
        pages.append(page.html())
    assert pages[0] == pages[1]


def test_loops_of_one_frequency_alone_lie_around_the_joint_ones(posterior):
    """The joint posterior in the place of each frequency's own: its median is zero, its bands hold the dashed lines."""
    found = compare_frequencies(posterior, replicates=50)
    figure = alone_loops_figure(replace(found, alone=dict.fromkeys(found.groups, posterior)))
    FigureCanvasAgg(figure).draw()
    assert len(figure.axes) == len(posterior.problem.loops)
    for ax in figure.axes:
        _, median, low, high = (np.asarray(line.get_ydata(), dtype=float) for line in ax.lines)
        assert np.max(np.abs(median)) < 1e-9 and np.all(low < 0.0) and np.all(high > 0.0)


def test_a_checkpoint_that_cannot_be_read_is_done_without(posterior, tmp_path):
    (tmp_path / "chains.ckpt").write_bytes(b"not a checkpoint")
    np.testing.assert_array_equal(sampling.history(posterior, tmp_path).z, sampling.history(posterior).z)


def test_plots_take_axes_widths_and_styles_and_show_themselves(posterior, tmp_path, few_quick_walkers):
    """`bi.plot`: as pages have them by default, with what the user's rcParams say, into axes of theirs."""
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    import bayes_iwan as bi

    figure = bi.plot.loops(posterior, width="column")
    assert figure.get_figwidth() == 3.5 and figure._repr_png_().startswith(b"\x89PNG")
    with mpl.rc_context({"lines.linewidth": 7.0}):
        own = Figure()
        ax = own.subplots()
        assert posterior.plot.frequencies(ax=ax) is own and any(x.get_linewidth() == 7.0 for x in ax.lines)
    for draw in (bi.plot.loops, bi.plot.frequencies, bi.plot.parameters, bi.plot.corner):
        sizes = []
        for size in (9.0, 18.0):  # this package's own, and twice that
            with mpl.rc_context({"font.size": size}):
                whole = draw(posterior, width="page")
                sizes.append({x.get_text(): x.get_fontsize() for x in whole.findobj(Text)})
        assert all(sizes[1][x] == 2.0 * of for x, of in sizes[0].items() if x in sizes[1]), draw
    assert max(map(len, repr(posterior).split("\n"))) <= 110
    for name in ("f.svg", "f.pdf", "f.png"):
        assert bi.plot.save(figure, tmp_path / name).stat().st_size > 1000
    with pytest.raises(ValueError, match="panels, 1 axes"):
        bi.plot.trends(posterior, ax=ax)
    assert whole.get_figwidth() == 7.2  # the last: a corner
    assert len(bi.plot.corner(posterior).for_phone().axes) == 10 < len(whole.axes)  # four quantities alone
    with pytest.raises(ValueError, match="makes its own axes"):
        bi.plot.corner(posterior, ax=ax)
    assert [bi.plot.loops(posterior, width=n).get_figwidth() for n in (1, 2)] == [3.5, 7.2]  # columns
    for name in set(bi.plot.__all__) - {"save"}:  # help shows what they all take
        assert {"style", "width", "ax"} <= set(inspect.signature(getattr(bi.plot, name)).parameters), name
    with pytest.raises(ValueError, match="a number of inches, or a name; did you mean 'column'"):
        bi.plot.loops(posterior, width="colum")
    with pytest.raises(ValueError, match="did you mean 'f10_a0"):
        bi.plot.loop(posterior, "f10_a0.csv")
    with pytest.raises(AttributeError, match="did you mean 'loops'"):
        posterior.plot.lops()


def test_methods_and_citation_are_of_what_was_run(posterior):
    import bayes_iwan as bi
    from bayes_iwan.report.identification.identification_page import Methods

    page = Page("methods")
    page.add(Methods(SimpleNamespace(posterior=posterior, iwan=True, clock=True)))
    said = " ".join(page.html().split())
    assert "4 harmonic tests at 10 to 20 Hz" in said and "Seed 1;" in said and bi.__version__ in said
    assert "emcee" in bi.cite() and "@software" in bi.cite().bibtex


@pytest.mark.parametrize("frequencies, amplitudes", [(1, 3), (5, 8), (1, 30), (13, 1)])
def test_of_many_tests_a_page_shows_some_from_end_to_end(frequencies, amplitudes):
    tests = [
        SimpleNamespace(record=SimpleNamespace(frequency_hz=f, amplitude_mm=a))
        for a in range(amplitudes, 0, -1)
        for f in range(frequencies)
    ]
    chosen = loops.some_tests(tests)
    assert len(chosen) == len(set(chosen)) == min(12, len(tests)) and chosen == sorted(chosen)
    shown = [(tests[t].record.frequency_hz, tests[t].record.amplitude_mm) for t in chosen]
    assert {(0, 1), (frequencies - 1, amplitudes)} <= set(shown)
    assert len({f for f, _ in shown}) == min(frequencies, 12)
