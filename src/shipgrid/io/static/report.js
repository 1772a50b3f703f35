"use strict";
// Draws a report's plots from the data in the page: the band of events, and one uPlot a panel, all on one time axis.
(function () {
  const data = JSON.parse(document.getElementById("data").textContent);
  const LEFT = 118, RIGHT = 14, ROW = 19, HEIGHT = 150;
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
    u.over.addEventListener("dblclick", () => zoom(FIRST, LAST));
    plots.push(u);
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
    const space = "http://www.w3.org/2000/svg", rows = data.bars.length, h = (rows + 1) * ROW + 4, plot = width - LEFT - RIGHT;
    const svg = document.createElementNS(space, "svg");
    svg.setAttribute("viewBox", `0 0 ${width} ${h}`);
    svg.setAttribute("height", h);
    const at = (t) => LEFT + plot * (t - range[0]) / (range[1] - range[0]);
    const add = (tag, attributes, text, title) => {
      const e = document.createElementNS(space, tag);
      for (const key in attributes) e.setAttribute(key, attributes[key]);
      if (text != null) e.textContent = text;
      if (title) { const t = document.createElementNS(space, "title"); t.textContent = title; e.append(t); }
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
  matchMedia("print").addEventListener("change", (event) => { if (event.matches) resize(700); redraw(); });
  addEventListener("afterprint", () => resize(host.clientWidth));
})();
