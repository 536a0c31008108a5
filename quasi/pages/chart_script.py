"""Style and script of the traces: they unpack the page's numbers and hand them to uPlot."""

CHART_STYLE = """
.panels { display: grid; gap: 2px 14px; } .panels.two { grid-template-columns: 1fr 1fr; }
.panels > div { min-width: 0; }
.answer { display: grid; grid-template-columns: 390px minmax(0, 1fr); gap: 18px; align-items: start; margin: 12px 0; }
.answer figure { margin: 0; }
@media (max-width: 820px) { .answer, .panels.two { grid-template-columns: minmax(0, 1fr); } }
.bar { display: flex; flex-wrap: wrap; gap: 6px; margin: 6px 0; align-items: center; font-size: 13px;
  color: var(--soft); }
.bar button { font: inherit; padding: 1px 9px; border: 1px solid var(--line); background: #fff; border-radius: 4px;
  cursor: pointer; color: var(--ink); }
.bar button.held { border-color: #1d6fb8; color: #1d6fb8; } .bar button:focus-visible { outline: 2px solid #1d6fb8; }
.bar .key { display: inline-block; width: 16px; height: 10px; margin: 0 4px 0 10px; }
.uplot { font-family: inherit; } .u-legend { font-size: 12px; text-align: left; margin: 0 0 0 62px; width: auto; }
.u-legend td, .uplot .u-legend th { border: 0; width: auto; white-space: nowrap; line-height: 1.2; font-weight: 400; }
.u-legend tr:first-child { min-width: 58px; } .u-inline tr { margin-right: 10px; }
.u-legend th, .u-legend td { padding: 0 2px; }
.u-legend .unnamed { display: none; }
@media print { .bar button, .u-legend .u-value { display: none; } }
"""

CHART_SCRIPT = """
(function () {
  "use strict";
  var data = JSON.parse(document.getElementById("traces").textContent);
  function bytes(text) {
    var raw = atob(text), out = new Uint8Array(raw.length);
    for (var i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
    return out.buffer;
  }
  function unpack(s) {
    var q = new Uint16Array(bytes(s.steps)), out = new Array(q.length);
    for (var i = 0; i < q.length; i++) out[i] = q[i] === 65535 ? null : s.low + s.step * q[i];
    return out;
  }
  function show(u, v) {
    if (v == null) return "";
    var a = Math.abs(v);
    return (a !== 0 && (a < 1e-3 || a >= 1e5) ? v.toExponential(2) : String(+v.toPrecision(4))).replace("-", "\\u2212");
  }
  var whole = [data.from, data.to], view = whole.slice(), plots = [];
  function zoom(from, to) {
    var span = Math.min(Math.max(to - from, 1e-3), whole[1] - whole[0]);
    from = Math.min(Math.max(from, whole[0]), whole[1] - span);
    view = [from, from + span];
    plots.forEach(function (p) {
      if (p.scales.x.min !== view[0] || p.scales.x.max !== view[1]) p.setScale("x", { min: view[0], max: view[1] });
    });
  }
  function shade(u) {
    var pen = u.ctx, box = u.bbox;
    data.spans.forEach(function (s) {
      var a = Math.max(u.valToPos(s.from, "x", true), box.left);
      var b = Math.min(Math.max(u.valToPos(s.to, "x", true), a + 1), box.left + box.width);
      if (b <= box.left || a >= box.left + box.width) return;
      pen.fillStyle = s.colour; pen.fillRect(a, box.top, b - a, box.height);
    });
    data.marks.forEach(function (m) {
      var x = u.valToPos(m.at, "x", true);
      if (x < box.left || x > box.left + box.width) return;
      pen.fillStyle = "#9aa3aa"; pen.fillRect(x, box.top, 1, box.height);
    });
  }
  function build(place, panel) {
    var t = new Float32Array(bytes(panel.t)), x = new Array(t.length);
    for (var i = 0; i < t.length; i++) x[i] = panel.begins + t[i];
    var options = {
      width: place.clientWidth, height: panel.height, legend: { show: true, live: true },
      cursor: { sync: { key: "time", scales: ["x", null] }, drag: { x: true, y: false }, points: { size: 5 },
        bind: { dblclick: function () { return function () { zoom(whole[0], whole[1]); return null; }; } } },
      scales: { x: { time: false, range: function (u, a, b) { return a === null ? view : [a, b]; } } },
      axes: [{ size: 26, font: "11px system-ui", ticks: { size: 4 }, gap: 3, grid: { stroke: "#eceff1" } },
        { size: 62, space: 22, font: "11px system-ui", label: panel.label, labelFont: "12px system-ui", labelSize: 18,
          gap: 2, ticks: { size: 4 }, grid: { stroke: "#eceff1" },
          values: function (u, all) { return all.map(function (v) { return show(u, v); }); } }],
      series: [{ label: "s", value: show }].concat(panel.series.map(function (s) {
        return { label: s.name || "interval", class: s.name ? undefined : "unnamed",
          stroke: s.colour, width: s.width, dash: s.dash || undefined, value: show,
          points: { show: false }, spanGaps: false };
      })),
      bands: panel.bands.map(function (b) { return { series: [b.upper + 1, b.lower + 1], fill: b.colour }; }),
      hooks: { drawClear: [shade], setScale: [function (u, key) {
        if (key !== "x" || !plots.length) return;
        if (u.scales.x.min !== view[0] || u.scales.x.max !== view[1]) zoom(u.scales.x.min, u.scales.x.max);
      }] }
    };
    var plot = new uPlot(options, [x].concat(panel.series.map(unpack)), place);
    plot.over.addEventListener("wheel", function (event) {
      if (!event.ctrlKey && !event.shiftKey) return;
      event.preventDefault();
      var at = plot.posToVal(event.clientX - plot.over.getBoundingClientRect().left, "x");
      var f = event.deltaY + event.deltaX > 0 ? 1.3 : 1 / 1.3;
      zoom(at - (at - view[0]) * f, at + (view[1] - at) * f);
    }, { passive: false });
    if (window.ResizeObserver) new ResizeObserver(function () {
      var width = place.clientWidth;
      if (width && width !== plot.width) plot.setSize({ width: width, height: panel.height });
    }).observe(place);
    plots.push(plot);
  }
  document.querySelectorAll("[data-panel]").forEach(function (place) {
    build(place, data.panels[+place.dataset.panel]);
  });
  document.querySelectorAll("[data-view]").forEach(function (button) {
    button.addEventListener("click", function () {
      var v = data.views[+button.dataset.view];
      zoom(v ? v.from : whole[0], v ? v.to : whole[1]);
    });
  });
  document.addEventListener("keydown", function (event) {
    if (!event.target.closest || !event.target.closest(".bar")) return;
    var span = view[1] - view[0], middle = (view[0] + view[1]) / 2, k = event.key;
    if (k === "+") zoom(middle - span / 4, middle + span / 4);
    else if (k === "-") zoom(middle - span, middle + span);
    else if (k === "ArrowLeft") zoom(view[0] - span / 4, view[1] - span / 4);
    else if (k === "ArrowRight") zoom(view[0] + span / 4, view[1] + span / 4);
    else return;
    event.preventDefault();
  });
  if (data.first) zoom(data.first.from, data.first.to); else zoom(whole[0], whole[1]);
})();
"""
