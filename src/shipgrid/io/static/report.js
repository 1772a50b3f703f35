"use strict";
// Draws a report's plots from the data in the page: the band of events, and one uPlot a panel, all on one time axis.
(function () {
  const data = JSON.parse(document.getElementById("data").textContent);
  const LEFT = 118, RIGHT = 22, ROW = 19, HEIGHT = 150, PAPER = 700;
  const [FIRST, LAST] = data.range;
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const colour = (k) => css("--c" + (k % 6));
  const host = document.getElementById("panels"), band = document.getElementById("band");
  let width = host.clientWidth, range = [FIRST, LAST], plots = [], zooming = false;

  const clock = (t) => {
    const s = Math.round(Math.abs(t)), h = Math.floor(s / 3600), two = (n) => String(n).padStart(2, "0");
    return (h ? h + ":" + two(Math.floor(s / 60) % 60) : String(Math.floor(s / 60))) + ":" + two(s % 60);
  };
  const number = (v) => (v == null ? "–" : String(+v.toPrecision(5)));

  const STEPS = [1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1].flatMap((s) => [s, 2 * s, 5 * s])
    .concat([1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 28800, 86400]);

  function ticks(u, axis, low, high) {             // round numbers of seconds, minutes or hours
    const most = Math.max(4, width / 110), day = STEPS[STEPS.length - 1];
    const step = STEPS.find((s) => (high - low) / s <= most) || day * Math.ceil((high - low) / most / day);
    const made = [];
    for (let k = Math.ceil(low / step - 1e-6); k * step <= high + 1e-6 * step; k++) made.push(k * step);
    return made;
  }

  function labels(at) {                            // seconds with as many digits as tell them apart, or a clock
    const step = at.length > 1 ? at[1] - at[0] : 1e-6;
    if (range[1] - range[0] >= 5 && step > 0.999) return at.map(clock);
    return at.map((t) => t.toFixed(Math.min(6, Math.max(0, Math.ceil(-Math.log10(step) - 1e-6)))) + " s");
  }

  function limits(panel) {
    return {
      hooks: { drawClear: [(u) => {
        const c = u.ctx, left = u.bbox.left, top = u.bbox.top;
        c.save();
        c.beginPath(); c.rect(left, top, u.bbox.width, u.bbox.height); c.clip();
        c.strokeStyle = css("--line"); c.lineWidth = devicePixelRatio;
        for (const [t] of data.events) {
          const x = Math.round(u.valToPos(t, "x", true));
          c.beginPath(); c.moveTo(x, top); c.lineTo(x, top + u.bbox.height); c.stroke();
        }
        c.strokeStyle = css("--limit"); c.setLineDash([5 * devicePixelRatio, 4 * devicePixelRatio]); c.globalAlpha = 0.7;
        for (const l of panel.limits) {
          const y = u.valToPos(l.level, "y", true);
          c.beginPath();
          c.moveTo(u.valToPos(Math.max(l.start || 0, FIRST), "x", true), y);
          c.lineTo(u.valToPos(l.end == null ? LAST : l.end, "x", true), y);
          c.stroke();
        }
        c.restore();
      }] },
    };
  }

  function height(panel) {                         // limits are shown where they are not far off
    return (u, low, high) => {
      if (low == null) return [0, 1];
      if (high - low < 1e-9 * Math.abs(high)) { const room = 0.05 * Math.abs(high) || 1; low -= room; high += room; }
      if (high - low < panel.least) { const room = (panel.least - (high - low)) / 2; low -= room; high += room; }
      const near = panel.limits.map((l) => l.level), span = high - low;
      for (const level of near) if (level > low - 2 * span && level < high + 2 * span) { low = Math.min(low, level); high = Math.max(high, level); }
      return uPlot.rangeNum(low, high, { min: { pad: 0.06 }, max: { pad: 0.06 } });
    };
  }

  function make(panel, last) {
    const box = document.createElement("div");
    box.className = "panel";
    box.innerHTML = "<h3></h3>";
    box.firstChild.textContent = panel.title;
    box.firstChild.insertAdjacentHTML("beforeend", " <span></span>");
    box.firstChild.lastChild.textContent = panel.unit;
    host.append(box);
    const series = [{ label: "time", value: (u, t) => (t == null ? "–" : clock(t) + " (" + number(t) + " s)") }];
    const columns = [panel.time], bands = [];
    const lineWidth = (k) => (panel.signals.length === 1 ? 1.6 : k === 0 ? 2.6 : 1.3);   // a curve under another stays visible
    panel.signals.forEach((s, k) => {
      if (!s.high) return;
      const hidden = { class: "envelope", stroke: "transparent", width: 0, points: { show: false }, spanGaps: false, pxAlign: 0 };
      series.push({ ...hidden, label: s.name + " high" }, { ...hidden, label: s.name + " low" });
      columns.push(s.high, s.low);
      bands.push({ series: [columns.length - 2, columns.length - 1], fill: () => colour(k) + "40" });
    });
    panel.signals.forEach((s, k) => {
      series.push({ label: s.name, stroke: () => colour(k), width: lineWidth(k), points: { show: false }, spanGaps: false, value: (u, v) => number(v) });
      columns.push(s.values);
    });
    const axis = { stroke: () => css("--quiet"), grid: { stroke: () => css("--grid"), width: 1 }, ticks: { show: false }, font: "11.5px system-ui, sans-serif" };
    const u = new uPlot({
      width, height: HEIGHT + (last ? 26 : 0), series, bands, plugins: [limits(panel)],
      padding: [8, RIGHT, 0, 0],
      scales: { x: { time: false, range: (self, low, high) => (low == null ? range : [low, high]) }, y: { range: height(panel) } },
      axes: [
        { ...axis, size: last ? 30 : 4, splits: ticks, values: (self, at) => (last ? labels(at) : at.map(() => "")) },
        { ...axis, size: LEFT, gap: 8, space: 28 },
      ],
      cursor: { sync: { key: "report", setSeries: false }, drag: { x: true, y: false }, points: { size: 6 } },
      hooks: { setScale: [(self, key) => { if (key === "x") zoom(self.scales.x.min, self.scales.x.max); }] },
    }, columns, box);
    u.setScale("x", { min: range[0], max: range[1] });
    u.onPaper = () => vector(u, panel, last, box);
    u.over.addEventListener("dblclick", () => zoom(FIRST, LAST));
    plots.push(u);
  }

  function element(tag, attributes, text) {
    const e = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const key in attributes) e.setAttribute(key, attributes[key]);
    if (text != null) e.textContent = text;
    return e;
  }

  function rounds(low, high) {                     // round numbers between two values, four of them or so
    const raw = (high - low) / 4, power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 2.5, 5, 10].find((k) => k * power >= raw), made = [];
    for (let k = Math.ceil(low / step - 1e-6); k * step <= high + 1e-6 * step; k++) made.push(+(k * step).toPrecision(8));
    return made;
  }

  function vector(u, panel, last, box) {           // what the canvas shows, drawn as lines: for paper
    const W = PAPER, H = last ? 132 : 118, left = LEFT, right = W - RIGHT, top = 6, bottom = H - (last ? 18 : 4);
    const { min: x0, max: x1 } = u.scales.x, { min: y0, max: y1 } = u.scales.y;
    const X = (t) => left + (right - left) * (t - x0) / (x1 - x0), Y = (v) => bottom - (bottom - top) * (v - y0) / (y1 - y0);
    const svg = element("svg", { viewBox: `0 0 ${W} ${H + 16}`, class: "vector" });
    const clip = "clip" + plots.indexOf(u), inside = element("g", { "clip-path": `url(#${clip})`, fill: "none" });
    const cut = element("clipPath", { id: clip });
    cut.append(element("rect", { x: left, y: top, width: right - left, height: bottom - top }));
    svg.append(cut);
    const line = (host, x, y, toX, toY, stroke, more) => host.append(element("line", { x1: x, y1: y, x2: toX, y2: toY, stroke, ...more }));
    for (const v of rounds(y0, y1)) {
      line(svg, left, Y(v), right, Y(v), css("--grid"));
      svg.append(element("text", { x: left - 8, y: Y(v) + 4, "text-anchor": "end" }, String(v)));
    }
    const at = ticks(null, 0, x0, x1), words = labels(at);
    at.forEach((t, k) => {
      line(svg, X(t), top, X(t), bottom, css("--grid"));
      if (last) svg.append(element("text", { x: X(t), y: H - 4, "text-anchor": "middle" }, words[k]));
    });
    for (const [t] of data.events) line(inside, X(t), top, X(t), bottom, css("--line"));
    for (const l of panel.limits)
      line(inside, X(Math.max(l.start || 0, FIRST)), Y(l.level), X(l.end == null ? LAST : l.end), Y(l.level), css("--limit"), { "stroke-dasharray": "5 4", "stroke-opacity": 0.7 });
    const trace = (values) => values.map((v, k) => (v == null ? "" : `${k && values[k - 1] != null ? "L" : "M"}${X(panel.time[k]).toFixed(2)} ${Y(v).toFixed(2)}`)).join("");
    let x = left;
    panel.signals.forEach((s, k) => {
      if (!s.high) return;
      let start = 0;
      for (let n = 0; n <= s.high.length; n++) {   // a polygon for each part without gaps
        if (n < s.high.length && s.high[n] != null) continue;
        const rows = panel.time.slice(start, n).map((_, j) => start + j), point = (j, v) => `${X(panel.time[j]).toFixed(2)},${Y(v).toFixed(2)}`;
        if (rows.length) inside.append(element("polygon", { fill: colour(k), "fill-opacity": 0.25, points: [...rows.map((j) => point(j, s.high[j])), ...rows.reverse().map((j) => point(j, s.low[j]))].join(" ") }));
        start = n + 1;
      }
    });
    panel.signals.forEach((s, k) => {
      inside.append(element("path", { d: trace(s.values), stroke: colour(k), "stroke-width": panel.signals.length === 1 ? 1.3 : k === 0 ? 2.2 : 1 }));
      svg.append(element("rect", { x, y: H + 4, width: 9, height: 9, fill: colour(k) }), element("text", { x: x + 14, y: H + 12.5 }, s.name));
      x += 30 + 7 * s.name.length;
    });
    svg.append(inside);
    box.querySelector(".vector")?.remove();
    box.append(svg);
  }

  function zoom(low, high) {
    if (zooming || low == null || (low === range[0] && high === range[1])) return;
    zooming = true;
    range = [Math.max(low, FIRST), Math.min(high, LAST)];
    for (const u of plots) u.setScale("x", { min: range[0], max: range[1] });
    drawBand();
    queueMicrotask(() => { zooming = false; });
  }

  function drawBand() {
    const rows = data.bars.length, h = (rows + 1) * ROW + 4, plot = width - LEFT - RIGHT;
    const svg = element("svg", { viewBox: `0 0 ${width} ${h}`, height: h });
    const at = (t) => LEFT + plot * (t - range[0]) / (range[1] - range[0]);
    const add = (tag, attributes, text, title) => {
      const e = element(tag, attributes, text);
      if (title) e.append(element("title", {}, title));
      svg.append(e);
      return e;
    };
    data.bars.forEach((row, k) => {
      const y = k * ROW + 2;
      add("text", { class: "name", x: LEFT - 8, y: y + 12.5 }, row.label, row.title);
      add("rect", { class: "slot", x: LEFT, y, width: plot, height: ROW - 4, rx: 2 });
      for (const [start, end, word] of row.bars) {
        const x1 = Math.max(at(start), LEFT), x2 = Math.min(at(end), LEFT + plot);
        if (x2 - x1 < 0.5) continue;
        const idle = /^(0(\.0+)?\b|-0\b)/.test(word);
        add("rect", { x: x1, y, width: Math.max(x2 - x1 - 1, 1), height: ROW - 4, rx: 2, fill: colour(k), "fill-opacity": idle ? 0.1 : 0.3 }, null,
          `${row.title}: ${word}, ${clock(start)} to ${clock(end)}`);
        if (x2 - x1 > 7 * word.length + 8) add("text", { x: x1 + 5, y: y + 12, "pointer-events": "none" }, word);
      }
    });
    const y = rows * ROW + 2, near = [];
    add("text", { class: "name", x: LEFT - 8, y: y + 12.5 }, "events");
    for (const [t, text] of data.events) {          // events that fall on one another share a tick
      const x = at(t);
      if (x < LEFT - 1 || x > LEFT + plot + 1) continue;
      const previous = near[near.length - 1];
      if (previous && x - previous.x < 3) previous.texts.push(clock(t) + "  " + text);
      else near.push({ x, texts: [clock(t) + "  " + text] });
    }
    for (const { x, texts } of near) {
      add("line", { class: "tick", x1: x, x2: x, y1: y, y2: y + ROW - 4 });
      add("rect", { class: "hit", x: x - 3, y, width: 7, height: ROW }, null, texts.join("\n"));
    }
    band.replaceChildren(svg);
  }

  function resize(to) {
    width = to;
    for (const u of plots) u.setSize({ width, height: u.height });
    drawBand();
  }

  data.panels.forEach((panel, k) => make(panel, k === data.panels.length - 1 || k % 4 === 3));
  drawBand();
  new ResizeObserver(() => { if (host.clientWidth && host.clientWidth !== width) resize(host.clientWidth); }).observe(host);
  const redraw = () => { for (const u of plots) u.redraw(false); drawBand(); };
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  const paper = () => { if (width !== PAPER) resize(PAPER); redraw(); for (const u of plots) u.onPaper(); };
  matchMedia("print").addEventListener("change", (event) => { if (event.matches) paper(); else redraw(); });
  addEventListener("beforeprint", paper);
  addEventListener("afterprint", () => resize(host.clientWidth));
})();
