"use strict";
(function () {
  const data = JSON.parse(document.getElementById("viewer-data").textContent), tests = data.tests;
  const MM = " " + data.displacement, N = " " + data.force;
  const get = (id) => document.getElementById(id);
  const plot = get("v-plot"), title = get("v-title"), NS = "http://www.w3.org/2000/svg";
  const LEFT = 70, RIGHT = 12, TOP = 12, BOTTOM = 48;
  let W = 720, H = 440;
  const BLUE = "#0072B2";

  function ticks(low, high, count) {
    const raw = (high - low) / count, power = Math.pow(10, Math.floor(Math.log10(raw)));
    const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw);
    const places = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    const out = [];
    for (let v = Math.ceil(low / step) * step; v <= high + 1e-9 * step; v += step) {
      out.push([v, (Math.abs(v) < step / 2 ? 0 : v).toFixed(places).replace("-", "\u2212")]);
    }
    return out;
  }
  function add(tag, attributes, text) {
    const e = document.createElementNS(NS, tag);
    for (const k in attributes) e.setAttribute(k, attributes[k]);
    if (text !== undefined) e.textContent = text;
    plot.appendChild(e);
    return e;
  }

  function draw() {
    // drawn at the width there is, so that a phone's letters are not shrunk
    W = Math.min(720, Math.max(300, plot.clientWidth || 720));
    H = Math.round(Math.min(440, 200 + W / 3));
    plot.setAttribute("viewBox", "0 0 " + W + " " + H);
    const t = tests[+get("v-test").value], what = get("v-what").value, model = get("v-model").value;
    const residual = what === "residual", n = t.u.length;
    const off = t.u.map((u, i) => residual ? t.model[2][i] : what === "friction" ? t.slope * u + t.zero : 0);
    const less = (y) => y.map((v, i) => v - off[i]);
    const x = residual ? t.u.map((_, i) => i / n) : t.u;
    // bands of the residual are those of an averaged loop, bands of a loop those of one more cycle
    const expected = residual ? t.loop : t.cycle;
    const lines = [];
    if (get("v-cycles").checked && !residual) {
      for (const c of t.cycles) {
        const f = what === "friction" ? c[1].map((v, i) => v - t.slope * c[0][i] - t.zero) : c[1];
        lines.push({ x: c[0], y: f, style: { stroke: "#9a9a9a", "stroke-width": 0.8 }, open: true });
      }
    }
    if (model === "draws") {
      for (const d of t.draws) lines.push({ x: x, y: less(d), style: { stroke: BLUE, "stroke-width": 0.7, "stroke-opacity": 0.6 } });
    } else {
      lines.push({ x: x, y: less(t.model[2]), style: { stroke: BLUE, "stroke-width": 1.8 } });
    }
    if (get("v-average").checked) {
      lines.push({ x: x, y: less(t.measured), style: residual ? { stroke: "#000", "stroke-width": 1.5 }
        : { stroke: "#000", "stroke-width": 1.8, "stroke-dasharray": "2 3" } });
    }
    const bands = model === "bands" ? expected.map(less) : [];
    let low = Infinity, high = -Infinity, a = Infinity, b = -Infinity;
    for (const s of lines.map((l) => l.y).concat(bands)) for (const v of s) { low = Math.min(low, v); high = Math.max(high, v); }
    for (const s of lines.map((l) => l.x).concat([x])) for (const v of s) { a = Math.min(a, v); b = Math.max(b, v); }
    if (residual) { a = 0; b = 1; }
    const pad = 0.05 * (high - low) || 1, side = residual ? 0 : 0.03 * (b - a);
    low -= pad; high += pad; a -= side; b += side;
    const X = (v) => LEFT + (v - a) / (b - a) * (W - LEFT - RIGHT);
    const Y = (v) => H - BOTTOM - (v - low) / (high - low) * (H - TOP - BOTTOM);
    const at = (p, q) => X(p).toFixed(1) + " " + Y(q).toFixed(1);

    while (plot.lastChild && plot.lastChild !== title) plot.removeChild(plot.lastChild);
    for (const [v, label] of ticks(a, b, Math.max(3, Math.round(W / 100)))) {
      add("path", { d: "M" + X(v).toFixed(1) + " " + TOP + "V" + (H - BOTTOM), stroke: "#e2e2e2" });
      add("text", { x: X(v), y: H - BOTTOM + 18, "text-anchor": "middle" }, label);
    }
    for (const [v, label] of ticks(low, high, 6)) {
      add("path", { d: "M" + LEFT + " " + Y(v).toFixed(1) + "H" + (W - RIGHT), stroke: "#e2e2e2" });
      add("text", { x: LEFT - 8, y: Y(v) + 4, "text-anchor": "end" }, label);
    }
    add("path", { d: "M" + LEFT + " " + TOP + "V" + (H - BOTTOM) + "H" + (W - RIGHT), stroke: "#444", fill: "none" });
    add("text", { x: (LEFT + W - RIGHT) / 2, y: H - 8, "text-anchor": "middle" }, residual ? "phase (cycles)" : "displacement u (" + data.displacement + ")");
    add("text", { x: 0, y: 0, transform: "translate(16 " + (TOP + H - BOTTOM) / 2 + ") rotate(-90)", "text-anchor": "middle" },
      (residual ? "measured \u2212 predicted (" : what === "friction" ? "friction force (" : "force (") + data.force + ")");
    // a band of a loop is drawn sample by sample, so that both branches keep their own
    for (const [i, j, shade] of bands.length ? [[0, 3, 0.22], [1, 2, 0.35]] : []) {
      let d = "";
      const last = residual ? n - 1 : n;
      for (let s = 0; s < last; s++) {
        const e = (s + 1) % n;
        d += "M" + at(x[s], bands[i][s]) + "L" + at(x[e], bands[i][e]) + "L" + at(x[e], bands[j][e]) + "L" + at(x[s], bands[j][s]) + "Z";
      }
      const g = add("path", { d: d, fill: BLUE, opacity: shade, stroke: BLUE, "stroke-width": 0.3 });
      g.setAttribute("class", "band");
    }
    for (const l of lines) {
      let d = l.x.map((v, i) => (i ? "L" : "M") + at(v, l.y[i])).join("");
      if (!residual && !l.open) d += "Z";
      add("path", Object.assign({ d: d, fill: "none", "stroke-linejoin": "round" }, l.style));
    }
    const phase = get("v-phase");
    phase.max = n - 1;
    const k = Math.min(+phase.value, n - 1);
    const m = t.measured[k] - off[k], f = t.model[2][k] - off[k];
    add("circle", { cx: X(x[k]), cy: Y(get("v-average").checked ? m : f), r: 5, fill: "none", stroke: "#D55E00", "stroke-width": 2.5 });
    const say = (v, d) => v.toFixed(d).replace("-", "\u2212");
    get("v-read").textContent = "phase " + (k / n).toFixed(3) + ": u = " + say(t.u[k], 3) + MM + ", measured " + say(m, 3) +
      N + ", " + (residual ? "expected " : "predicted ") + say(f, 3) + N + " [90 %: " + say(expected[0][k] - off[k], 3) + ", " +
      say(expected[3][k] - off[k], 3) + "], residual " + say(t.measured[k] - t.model[2][k], 4) + N;
    phase.setAttribute("aria-valuetext", "phase " + (k / n).toFixed(3));
    title.textContent = t.name + ": " + get("v-what").selectedOptions[0].textContent;
    get("v-cycles").disabled = residual;
  }
  for (const id of ["v-test", "v-what", "v-model", "v-cycles", "v-average"]) get(id).addEventListener("change", draw);
  get("v-phase").addEventListener("input", draw);
  window.addEventListener("resize", draw);
  draw();
})();
