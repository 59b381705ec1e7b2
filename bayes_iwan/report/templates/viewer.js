"use strict";
// One test's loop in a uPlot: axes, zoom and pointer are the library's, loops and bands are painted here.
(function () {
  const data = JSON.parse(document.getElementById("viewer-data").textContent);
  const get = (id) => document.getElementById(id), box = get("v-plot"), phase = get("v-phase");
  const effects = Array.from(document.querySelectorAll(".v-effect"));
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  let plot = null, shown = null;

  function colours() {
    return dark.matches ? { ink: "#e6e6e6", grid: "#3a3a3a", cycle: "#7a7a7a", model: "#56b4e9", alone: "#e69f00" }
      : { ink: "#1b1b1b", grid: "#e2e2e2", cycle: "#9a9a9a", model: "#0072b2", alone: "#d55e00" };
  }

  // what is to be drawn: lines {x, y, colour, width, dash, closed} and bands {x, low, high, shade}
  function content() {
    const c = colours(), t = data.tests[+get("v-test").value], what = get("v-what").value, n = t.u.length;
    const model = get("v-model") ? get("v-model").value : "median", residual = what === "residual";
    const on = effects.reduce((bits, e) => bits + (e.checked ? 1 << +e.value : 0), 0);
    const middle = t.sets ? t.sets[on] : t.model[2];
    const off = t.u.map((u, i) => residual ? middle[i] : what === "friction" ? t.slope * u + t.zero : 0);
    const less = (y) => y.map((v, i) => v - off[i]);
    const x = residual ? t.u.map((_, i) => i / n) : t.u;
    const lines = [], bands = [], counted = { cycles: 0, average: 0, bands: 0, draws: 0, alone: 0 };
    const add = (kind, line) => { lines.push(Object.assign({ x: x, closed: !residual }, line)); counted[kind] += 1; };
    if (get("v-cycles").checked && !residual) {
      for (const [u, f] of t.cycles) {
        add("cycles", { x: u, y: what === "friction" ? f.map((v, i) => v - t.slope * u[i] - t.zero) : f,
          colour: c.cycle, width: 0.8, closed: false });
      }
    }
    if (model === "draws") for (const d of t.draws) add("draws", { y: less(d), colour: c.model, width: 0.6, alpha: 0.45 });
    if (model === "bands") {
      // bands of the residual are those of an averaged loop, bands of a loop those of one more cycle
      const expected = residual ? t.loop : t.cycle;
      for (const [i, j, shade] of [[0, 3, 0.22], [1, 2, 0.35]]) {
        bands.push({ x: x, low: less(expected[i]), high: less(expected[j]), shade: shade, colour: c.model });
        counted.bands += 1;
      }
    }
    if (t.sets && on) add("alone", { y: less(t.sets[0]), colour: c.alone, width: 1.4, dash: [7, 3] });
    lines.push({ x: x, y: less(middle), colour: c.model, width: 1.8, closed: !residual });
    if (get("v-average").checked) add("average", { y: less(t.measured), colour: c.ink, width: 1.6, dash: residual ? [] : [2, 3] });
    return { t: t, n: n, x: x, off: off, middle: middle, residual: residual, what: what, lines: lines, bands: bands, counted: counted };
  }

  function paint(u) {
    const ctx = u.ctx, b = u.bbox, px = window.devicePixelRatio || 1;
    const X = (v) => u.valToPos(v, "x", true), Y = (v) => u.valToPos(v, "y", true);
    ctx.save();
    ctx.beginPath();
    ctx.rect(b.left, b.top, b.width, b.height);
    ctx.clip();
    for (const s of shown.bands) { // sample by sample, so that both branches of a loop keep their own
      const n = s.x.length, path = new Path2D();
      for (let i = 0; i < (shown.residual ? n - 1 : n); i++) {
        const e = (i + 1) % n;
        path.moveTo(X(s.x[i]), Y(s.low[i]));
        path.lineTo(X(s.x[e]), Y(s.low[e]));
        path.lineTo(X(s.x[e]), Y(s.high[e]));
        path.lineTo(X(s.x[i]), Y(s.high[i]));
        path.closePath();
      }
      ctx.globalAlpha = s.shade;
      ctx.fillStyle = s.colour;
      ctx.fill(path);
    }
    for (const l of shown.lines) {
      ctx.beginPath();
      l.x.forEach((v, i) => i ? ctx.lineTo(X(v), Y(l.y[i])) : ctx.moveTo(X(v), Y(l.y[i])));
      if (l.closed) ctx.closePath();
      ctx.globalAlpha = l.alpha || 1;
      ctx.strokeStyle = l.colour;
      ctx.lineWidth = l.width * px;
      ctx.setLineDash((l.dash || []).map((d) => d * px));
      ctx.stroke();
    }
    const k = Math.min(+phase.value, shown.n - 1);
    ctx.setLineDash([]);
    ctx.globalAlpha = 1;
    ctx.strokeStyle = "#d55e00";
    ctx.lineWidth = 2.5 * px;
    ctx.beginPath();
    ctx.arc(X(shown.x[k]), Y(shown.t.measured[k] - shown.off[k]), 5 * px, 0, 2 * Math.PI);
    ctx.stroke();
    ctx.restore();
  }

  function read() {
    const s = shown, t = s.t, k = Math.min(+phase.value, s.n - 1), say = (v, d) => v.toFixed(d).replace("-", "\u2212");
    const N = " " + data.force, band = t.cycle ? (s.residual ? t.loop : t.cycle) : null;
    get("v-read").textContent = "phase " + (k / s.n).toFixed(3) + ": u = " + say(t.u[k], 3) + " " + data.displacement +
      ", measured " + say(t.measured[k] - s.off[k], 3) + N + ", " + (s.residual ? "expected " : "predicted ") +
      say(s.middle[k] - s.off[k], 3) + N +
      (band ? " [90 %: " + say(band[0][k] - s.off[k], 3) + ", " + say(band[3][k] - s.off[k], 3) + "]" : "") +
      ", residual " + say(t.measured[k] - s.middle[k], 4) + N;
    phase.setAttribute("aria-valuetext", "phase " + (k / s.n).toFixed(3));
  }

  function nearest(u) {
    if (u.cursor.left < 0 || !shown) return;
    let best = Infinity, at = +phase.value;
    for (let i = 0; i < shown.n; i++) {
      const dx = u.valToPos(shown.x[i], "x") - u.cursor.left, dy = u.valToPos(shown.t.measured[i] - shown.off[i], "y") - u.cursor.top;
      if (dx * dx + dy * dy < best) { best = dx * dx + dy * dy; at = i; }
    }
    if (at !== +phase.value) { phase.value = at; read(); u.redraw(false); }
  }

  function draw() {
    shown = content();
    const c = colours(), s = shown, width = Math.max(280, Math.min(box.clientWidth || 720, 928));
    let [a, b, low, high] = [Infinity, -Infinity, Infinity, -Infinity];
    const ys = s.lines.map((l) => l.y).concat(...s.bands.map((x) => [x.low, x.high]));
    for (const y of ys) for (const v of y) { low = Math.min(low, v); high = Math.max(high, v); }
    for (const l of s.lines) for (const v of l.x) { a = Math.min(a, v); b = Math.max(b, v); }
    const pad = 0.05 * (high - low) || 1, side = s.residual ? 0 : 0.03 * (b - a);
    const axis = (label, size) => ({ label: label, size: size, labelSize: 22, stroke: c.ink, font: "13px system-ui, sans-serif",
      labelFont: "13px system-ui, sans-serif", grid: { stroke: c.grid, width: 1 }, ticks: { stroke: c.grid, width: 1 } });
    if (plot) plot.destroy();
    plot = new uPlot({
      width: width, height: Math.round(Math.min(480, 200 + width / 3)), legend: { show: false },
      scales: { x: { time: false, range: (u, p, q) => [p, q] }, y: { range: (u, p, q) => [p, q] } },
      series: [{}, { paths: () => null, points: { show: false } }],
      axes: [axis(s.residual ? "phase (cycles)" : "displacement u (" + data.displacement + ")", 34),
        axis((s.residual ? "measured \u2212 predicted (" : s.what === "friction" ? "friction force (" : "force (") + data.force + ")", 62)],
      cursor: { drag: { x: true, y: true, uni: 20 }, points: { show: false } },
      hooks: { draw: [paint], setCursor: [nearest] },
    }, [[a - side, b + side], [low - pad, high + pad]], box);
    phase.max = s.n - 1;
    box.setAttribute("aria-label", s.t.name + ": " + get("v-what").selectedOptions[0].textContent);
    box.dataset.drawn = JSON.stringify(s.counted);
    get("v-cycles").disabled = s.residual;
    read();
  }
  for (const e of ["v-test", "v-what", "v-model", "v-cycles", "v-average"].map(get).concat(effects)) {
    if (e) e.addEventListener("change", draw);
  }
  phase.addEventListener("input", () => { read(); plot.redraw(false); });
  get("v-whole").addEventListener("click", draw);
  dark.addEventListener("change", draw);
  let before = 0;
  window.addEventListener("resize", () => { if (box.clientWidth !== before) { before = box.clientWidth; draw(); } });
  draw();
})();
