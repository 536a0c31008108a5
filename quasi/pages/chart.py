"""The comparison that can be zoomed, in the pages of models and gaps: its element, style and script. No network.

The page holds the rows as JSON: times and, per axis, measurement, prediction and half width of the interval as 16-bit
steps of the axis's range (65535 stands for unknown). The script draws them on a canvas.
"""

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from quasi.pages import frame

UNKNOWN = 65535
STYLE = """
.chart { margin: 10px 0 26px; } .chart canvas { width: 100%; height: 420px; display: block; cursor: grab;
  border: 1px solid var(--line); touch-action: none; }
.chart canvas:active { cursor: grabbing; } .chart canvas:focus { outline: 2px solid #1d6fb8; }
.chart .bar { display: flex; flex-wrap: wrap; gap: 6px; margin: 6px 0; align-items: center; font-size: 13.5px; }
.chart button { font: inherit; padding: 2px 10px; border: 1px solid var(--line); background: #fff; border-radius: 4px;
  cursor: pointer; color: var(--ink); }
.chart button[aria-pressed=true] { background: var(--ink); color: #fff; }
.chart .held { border-color: #1d6fb8; color: #1d6fb8; } .chart .readout { color: var(--soft); min-height: 1.5em; }
.chart .key { display: inline-block; width: 18px; height: 3px; vertical-align: middle; margin: 0 4px 0 10px; }
@media print { .chart .bar, .chart .readout { display: none; } }
"""

SCRIPT = """
(function () {
  "use strict";
  var data = JSON.parse(document.getElementById("rows").textContent);
  function bytes(text) {
    var raw = atob(text), out = new Uint8Array(raw.length);
    for (var i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
    return out.buffer;
  }
  var t = new Float32Array(bytes(data.t)), n = t.length, gap = new Uint8Array(n), series = {};
  data.starts.forEach(function (i) { gap[i] = 1; });
  function unpack(text, low, step) {
    var q = new Uint16Array(bytes(text)), out = new Float64Array(q.length);
    for (var i = 0; i < q.length; i++) out[i] = q[i] === 65535 ? NaN : low + step * q[i];
    return out;
  }
  function of(axis) {
    if (!series[axis]) {
      var a = data.axes[axis];
      series[axis] = { unit: a.unit, m: unpack(a.measured, a.low, a.step), p: unpack(a.model, a.low, a.step),
        h: unpack(a.half, 0, a.step) };
    }
    return series[axis];
  }
  var box = document.getElementById("chart"), canvas = box.querySelector("canvas"), pen = canvas.getContext("2d");
  var readout = box.querySelector(".readout"), axisNow = Object.keys(data.axes)[0];
  var whole = [t[0], t[n - 1]], view = whole.slice(), pointer = null;
  var L = 74, R = 12, TOP = 24, FOOT = 30;

  function find(x) {
    var a = 0, b = n;
    while (a < b) { var c = (a + b) >> 1; if (t[c] < x) a = c + 1; else b = c; }
    return a;
  }
  function nice(span, most) {
    var raw = span / most, power = Math.pow(10, Math.floor(Math.log10(raw))), f = raw / power;
    return (f <= 1 ? 1 : f <= 2 ? 2 : f <= 5 ? 5 : 10) * power;
  }
  function said(v, step) {
    var d = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    return (d > 4 || Math.abs(v) >= 1e5 ? v.toExponential(1) : v.toFixed(d)).replace("-", "\\u2212");
  }
  function draw() {
    var ratio = window.devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
    if (canvas.width !== Math.round(w * ratio)) {
      canvas.width = Math.round(w * ratio);
      canvas.height = Math.round(h * ratio);
    }
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, w, h);
    pen.font = "12px system-ui, sans-serif";
    var s = of(axisNow), i0 = Math.max(find(view[0]) - 1, 0), i1 = Math.min(find(view[1]) + 1, n);
    var mid = TOP + (h - TOP - FOOT) * 0.72, low = Infinity, high = -Infinity, worst = 0, i;
    for (i = i0; i < i1; i++) {
      if (s.m[i] < low) low = s.m[i]; if (s.m[i] > high) high = s.m[i];
      if (s.p[i] < low) low = s.p[i]; if (s.p[i] > high) high = s.p[i];
      var e = Math.abs(s.m[i] - s.p[i]); if (e > worst) worst = e;
    }
    if (!(low < high)) { low = (low || 0) - 1; high = low + 2; }
    var pad = 0.06 * (high - low); low -= pad; high += pad; worst = worst * 1.1 || 1;
    function X(x) { return L + (x - view[0]) / (view[1] - view[0]) * (w - L - R); }
    function Y(y) { return mid - 8 - (y - low) / (high - low) * (mid - 8 - TOP); }
    function E(y) { return (mid + 6 + h - FOOT) / 2 - y / worst * (h - FOOT - mid - 6) / 2; }
    data.flights.forEach(function (f) {
      var a = Math.max(X(t[f.from]), L), b = Math.min(X(t[f.to - 1]), w - R);
      if (b <= L || a >= w - R) return;
      if (f.role === "validation") {
        pen.fillStyle = "rgba(29,111,184,0.09)";
        pen.fillRect(a, TOP, b - a, h - TOP - FOOT);
      }
      pen.strokeStyle = "#c3cad0"; pen.beginPath(); pen.moveTo(b, TOP); pen.lineTo(b, h - FOOT); pen.stroke();
      pen.fillStyle = f.role === "validation" ? "#1d6fb8" : "#5b6770"; pen.textAlign = "center";
      var name = pen.measureText(f.key).width < b - a - 4 ? f.key : "";
      pen.fillText(name, (a + b) / 2, TOP - 8);
    });
    pen.strokeStyle = "#e7eaed"; pen.fillStyle = "#5b6770"; pen.lineWidth = 1;
    function ticks(a, b, most, place) {
      var d = nice(b - a, most);
      for (var k = Math.ceil(a / d); k * d <= b; k++) place(k * d, d);
    }
    function beside(word, at) {
      pen.save(); pen.translate(13, at); pen.rotate(-Math.PI / 2); pen.fillText(word, 0, 0); pen.restore();
    }
    pen.textAlign = "right";
    function level(place) {
      return function (v, d) { line(L, place(v), w - R, place(v)); pen.fillText(said(v, d), L - 6, place(v) + 4); };
    }
    ticks(low, high, Math.max((mid - TOP) / 45, 2), level(Y));
    ticks(-worst, worst, Math.max((h - FOOT - mid) / 18, 1.5), level(E));
    pen.textAlign = "center";
    ticks(view[0], view[1], Math.max((w - L - R) / 95, 2), function (v, d) {
      line(X(v), TOP, X(v), h - FOOT);
      pen.fillText(said(v, d), X(v), h - FOOT + 15);
    });
    pen.fillText("s", w - R - 4, h - 4);
    beside(axisNow + ", " + s.unit, (TOP + mid) / 2);
    beside("residual", (mid + h - FOOT) / 2);
    function line(a, b, c, d) { pen.beginPath(); pen.moveTo(a, b); pen.lineTo(c, d); pen.stroke(); }
    pen.save(); pen.beginPath(); pen.rect(L, TOP, w - L - R, h - TOP - FOOT); pen.clip();
    var dense = i1 - i0 > 2.5 * (w - L - R);
    band();
    curve(s.m, null, Y, "#3b444b", 1.1);
    curve(s.p, null, Y, "#d62728", 1.0);
    curve(s.m, s.p, E, "#3b444b", 0.9);
    pen.restore();

    function columns(value, use) {
      var column = -1, a = 0, b = 0;
      for (var i = i0; i < i1; i++) {
        var v = value(i); if (v !== v) continue;
        var c = Math.floor(X(t[i]));
        if (c !== column) { if (column >= 0) use(column, a, b); column = c; a = b = v; }
        else { if (v < a) a = v; if (v > b) b = v; }
      }
      if (column >= 0) use(column, a, b);
    }
    function curve(y, less, place, colour, width) {
      pen.strokeStyle = colour; pen.lineWidth = width; pen.beginPath();
      if (dense) {
        columns(function (i) { return less ? y[i] - less[i] : y[i]; }, function (c, a, b) {
          var p = place(a), q = place(b); if (p - q < 1) p = q + 1;
          pen.moveTo(c + 0.5, p); pen.lineTo(c + 0.5, q);
        });
      } else {
        for (var i = i0; i < i1; i++) {
          var v = less ? y[i] - less[i] : y[i];
          if (gap[i] || v !== v) pen.moveTo(X(t[i]), place(v)); else pen.lineTo(X(t[i]), place(v));
        }
      }
      pen.stroke();
    }
    function band() {
      pen.fillStyle = "rgba(214,39,40,0.18)";
      if (dense) {
        columns(function (i) { return s.p[i]; }, function (c, a, b) {
          var at = view[0] + (c - L) / (w - L - R) * (view[1] - view[0]), half = s.h[Math.min(find(at), n - 1)] || 0;
          pen.fillRect(c, Y(b + half), 1, Math.max(Y(a - half) - Y(b + half), 1));
        });
        return;
      }
      for (var i = i0; i < i1;) {
        var j = i + 1; while (j < i1 && !gap[j]) j++;
        pen.beginPath();
        for (var k = i; k < j; k++) pen.lineTo(X(t[k]), Y(s.p[k] + s.h[k]));
        for (k = j - 1; k >= i; k--) pen.lineTo(X(t[k]), Y(s.p[k] - s.h[k]));
        pen.fill(); i = j;
      }
    }
  }
  function limit() {
    var span = Math.min(Math.max(view[1] - view[0], 0.05), whole[1] - whole[0]);
    var a = Math.min(Math.max(view[0], whole[0]), whole[1] - span);
    view = [a, a + span];
  }
  function zoom(factor, at) {
    var c = at === undefined ? (view[0] + view[1]) / 2 : at;
    view = [c - (c - view[0]) * factor, c + (view[1] - c) * factor]; limit(); draw();
  }
  function shift(by) { view = [view[0] + by, view[1] + by]; limit(); draw(); }
  function time(event) {
    var r = canvas.getBoundingClientRect();
    return view[0] + (event.clientX - r.left - L) / (r.width - L - R) * (view[1] - view[0]);
  }
  canvas.addEventListener("wheel", function (e) {
    e.preventDefault();
    zoom(e.deltaY > 0 ? 1.25 : 0.8, time(e));
  }, { passive: false });
  canvas.addEventListener("pointerdown", function (e) { pointer = time(e); canvas.setPointerCapture(e.pointerId); });
  canvas.addEventListener("pointerup", function () { pointer = null; });
  canvas.addEventListener("pointermove", function (e) {
    var x = time(e);
    if (pointer !== null) { shift(pointer - x); return; }
    var i = Math.min(Math.max(find(x), 0), n - 1), s = of(axisNow);
    var f = data.flights.filter(function (f) { return i >= f.from && i < f.to; })[0];
    if (!f) { readout.textContent = ""; return; }
    readout.textContent = f.key + ", " + (t[i] - t[f.from] + f.begins).toFixed(2) + " s: measured " +
      s.m[i].toPrecision(4) + ", model " + s.p[i].toPrecision(4) + " \\u00b1 " + s.h[i].toPrecision(2) + " " + s.unit;
  });
  canvas.addEventListener("dblclick", function () { view = whole.slice(); draw(); });
  canvas.addEventListener("keydown", function (e) {
    var span = view[1] - view[0];
    if (e.key === "ArrowLeft") shift(-0.2 * span); else if (e.key === "ArrowRight") shift(0.2 * span);
    else if (e.key === "+" || e.key === "ArrowUp") zoom(0.8);
    else if (e.key === "-" || e.key === "ArrowDown") zoom(1.25);
    else if (e.key === "Home") { view = whole.slice(); draw(); } else return;
    e.preventDefault();
  });
  function press(buttons, pressed) {
    buttons.forEach(function (b) { b.setAttribute("aria-pressed", b === pressed ? "true" : "false"); });
  }
  var axes = Array.prototype.slice.call(box.querySelectorAll("button[data-axis]"));
  axes.forEach(function (b) {
    b.addEventListener("click", function () { axisNow = b.dataset.axis; press(axes, b); draw(); });
  });
  var flights = Array.prototype.slice.call(box.querySelectorAll("button[data-flight]"));
  flights.forEach(function (b) {
    b.addEventListener("click", function () {
      var f = data.flights[+b.dataset.flight];
      view = f ? [t[f.from], t[f.to - 1]] : whole.slice(); limit(); draw();
    });
  });
  press(axes, axes[0]);
  if (window.ResizeObserver) new ResizeObserver(draw).observe(canvas); else window.addEventListener("resize", draw);
  draw();
})();
"""


def step_of(low: float, high: float) -> float:
    """The step by which values from low to high are packed."""
    return (high - low) / (UNKNOWN - 1) or 1.0


def packed(values: np.ndarray, low: float, step: float) -> str:
    """Values as 16-bit steps above low, in base 64; what is not finite is unknown."""
    steps = np.where(np.isfinite(values), np.clip(np.round((values - low) / step), 0, UNKNOWN - 1), UNKNOWN)
    return base64.b64encode(steps.astype("<u2").tobytes()).decode("ascii")


def chart(
    t: np.ndarray,
    starts: Sequence[int],
    flights: Iterable[Mapping[str, Any]],
    axes: Mapping[str, Mapping[str, Any]],
    elsewhere: str,
    interval: bool = False,
) -> str:
    """The comparison as HTML.

    t          (N,) s, flight behind flight; starts  rows at which a line begins
    flights    each {"key", "role" ("validation" is marked), "from", "to", "begins"}
    axes       {name: {"unit", "low", "step", "measured", "model", "half"}}, the last three packed
    elsewhere  where readers without scripts find the same; interval  whether "half" is that of a prediction interval
    """
    flights = list(flights)
    data = {"t": base64.b64encode(t.astype("<f4").tobytes()).decode("ascii"), "starts": starts, "flights": flights,
            "axes": axes}  # fmt: skip
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")  # no text may end the element that holds it
    buttons = "".join(f'<button data-axis="{a}">{a}</button>' for a in axes)
    held = {True: " class=held", False: ""}
    places = "".join(
        f'<button data-flight="{k}"{held[f["role"] == "validation"]}>{frame.escape(f["key"])}</button>'
        for k, f in enumerate(flights)
    )
    band = '<span class="key" style="background:#f6d3d3;height:10px"></span>prediction interval' if interval else ""
    return (
        f'<div class="chart" id="chart"><div class="bar">{buttons}'
        '<span class="key" style="background:#3b444b"></span>measured'
        f'<span class="key" style="background:#d62728"></span>model{band}</div>'
        '<canvas tabindex="0" role="img" aria-label="Measured and modelled forces and moments over time"></canvas>'
        '<div class="readout">Wheel or + and − zoom, drag or arrow keys move, double click shows all.</div>'
        f'<div class="bar"><button data-flight="all">all flights</button>{places}</div>'
        f"<noscript>The comparison needs a browser that runs the page's script; {elsewhere}.</noscript></div>"
        f'<script type="application/json" id="rows">{text}</script><script>{SCRIPT}</script>'
    )
