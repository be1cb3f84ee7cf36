/* The plot of one signal over time: its value, bounds, level and alerts. Plain SVG, no dependency.

   const view = new HealthPlot.View(from, to, utcOffset);  // times in s since 1970; plots can share a view
   const plot = new HealthPlot.Plot(element, signal, view);
   plot.update(signal);  // new data, the same view
   plot.pick(id);  // marks an alert; "" marks none

   signal: {
     name, unit,  // texts
     start, width,  // of the first bucket and of each bucket, in s
     steps: [1, 1, 5, ...],  // from bucket to bucket, in buckets; the first one: from -1
     low: [...], high: [...],  // smallest and largest values
     mean: [...],  // means, the line within wide buckets; may be left out
     bad: [t, ...],  // times of bad samples
     gap,  // the line breaks where there is no bucket for so many s
     bounds: [{level: "WARN", side: "below", value: 20, clears: 22}, ...],
     levels: [[t, "OK"], [t, ""], ...],  // level from t on; "": unknown
     alerts: [{id, t, level, text}, ...],  // id: of the element that shows its text
     until,  // end of what is known; left out: that of the view
     ahead: [...]  // lines of forecasts: see ahead.js; may be left out
   }

   All texts become text nodes: none is parsed as HTML. */
const HealthPlot = (() => {
const SVG = "http://www.w3.org/2000/svg";
const HEIGHT = {top: 18, plot: 250, gap: 8, strip: 16, axis: 20};
const LEFT = 62, RIGHT = 10, NARROWEST = 240, PAPER_WIDTH = 680, MARKER_SPACE = 11;
const RANK = {"": -1, OK: 0, WARN: 1, STALE: 2, ERROR: 3};
const STRIP_SHARE = {"": 1, OK: 0.3, WARN: 0.8, STALE: 1, ERROR: 1};  // levels differ in height, not in colour alone
const STEPS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800,
  3600, 7200, 10800, 21600, 43200, 86400, 172800, 604800, 2592000, 31536000];
const CHARACTER = 7.4, LINE = 13, NARROW = 480, LONGEST_UNIT = 4;  // of the texts, in pixels
let plots = 0;

const {clamp} = HealthPlotViews;
const pixel = (value) => value.toFixed(1);
const numberText = (value) => String(Number(value.toPrecision(5)));
const shortened = (text, most) => (text.length > most ? `${text.slice(0, Math.max(1, most - 1))}…` : text);
const withUnit = (text, unit) => (unit ? `${text} ${unit}` : text);

/** Returns the local time of `t`, with fractions of a second where `step` is below 1 s. */
function timeText(t, utcOffset, step, withDate) {
  const local = new Date((t + utcOffset) * 1000);
  if (Number.isNaN(local.getTime())) return `${numberText(t)} s`;
  const iso = local.toISOString();
  const time = iso.slice(iso.length - 13, step < 1 ? -1 : step < 60 ? -5 : -8);
  return withDate ? `${iso.slice(0, iso.length - 14)} ${time}` : time;
}

/** Returns a new element, the last one of `parent` if that is not null. */
function add(parent, name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes || {})) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  if (parent) parent.append(element);
  return element;
}

/** Returns the place of the first of ascending numbers that is at least `wanted`. */
function firstAtLeast(numbers, wanted) {
  let low = 0, high = numbers.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (numbers[middle] < wanted) low = middle + 1; else high = middle;
  }
  return low;
}

function niceStep(span, most) {
  const rough = span / most, power = 10 ** Math.floor(Math.log10(rough));
  return power * ([1, 2, 5].find((factor) => factor * power >= rough) || 10);
}

class Plot extends HealthPlotViews.Gestures {
  constructor(element, signal, view) {
    super();
    this.element = element;
    this.view = view;
    this.picked = "";
    this.at = null;
    this.id = `plot-${++plots}`;
    element.classList.add("plot");
    element.plot = this;
    const bar = document.createElement("div");
    bar.className = "plot-bar";
    this.output = document.createElement("output");
    bar.append(this.output);
    this.zoomIn = this.button(bar, "+", "zoom in", () => view.zoom(0.5));
    this.zoomOut = this.button(bar, "−", "zoom out", () => view.zoom(2));
    this.all = this.button(bar, "all", "show all", () => view.showAll());
    element.append(bar);
    this.svg = add(element, "svg", {tabindex: 0, role: "group"});
    this.listen();
    view.onChange.push(() => this.draw());
    if (typeof ResizeObserver === "function") {
      new ResizeObserver(() => {
        if (element.clientWidth && Math.abs(element.clientWidth - this.width) > 1) requestAnimationFrame(() => this.draw());
      }).observe(element);
    }
    this.update(signal);
  }

  update(signal) {
    this.signal = signal;
    let place = -1;
    this.times = signal.steps.map((step) => signal.start + ((place += step) + 0.5) * signal.width);
    this.levelTimes = signal.levels.map(([t]) => t);
    this.draw();
  }

  pick(id) {
    this.picked = id;
    const alert = this.signal.alerts.find((each) => each.id === id);
    if (alert) this.at = alert.t;
    this.draw();
  }

  button(parent, text, meaning, action) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = text;
    button.title = meaning;
    button.setAttribute("aria-label", meaning);
    button.addEventListener("click", action);
    parent.append(button);
    return button;
  }

  get until() { return this.signal.until ?? this.view.last; }

  get left() { return LEFT; }

  get top() { return HEIGHT.top; }

  get bottom() { return HEIGHT.top + HEIGHT.plot; }

  x(t) { return LEFT + (t - this.view.from) / (this.view.to - this.view.from) * (this.right - LEFT); }

  t(x) { return this.view.from + (x - LEFT) / (this.right - LEFT) * (this.view.to - this.view.from); }

  y(value) { return HEIGHT.top + (this.highest - value) / (this.highest - this.lowest) * HEIGHT.plot; }

  levelAt(t) {
    const place = firstAtLeast(this.levelTimes, t + 1e-3) - 1;
    return place < 0 ? "" : this.signal.levels[place][1];
  }

  draw(width = 0) {
    const {svg, signal, view} = this;
    this.width = Math.max(width || this.element.clientWidth || 640, NARROWEST);
    this.setBoundNames();
    const bottom = HEIGHT.top + HEIGHT.plot;
    const height = bottom + HEIGHT.gap + HEIGHT.strip + HEIGHT.axis;
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${this.width} ${height}`);
    const defs = add(svg, "defs");
    for (const kind of ["hatch", "unknown"]) {
      const hatch = add(defs, "pattern",
        {id: `${this.id}-${kind}`, width: 6, height: 6, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)"});
      add(hatch, "path", {class: kind, d: "M0 0v6"});
    }
    add(add(defs, "clipPath", {id: `${this.id}-clip`}), "rect",
      {x: LEFT, y: HEIGHT.top - 1, width: this.right - LEFT, height: HEIGHT.plot + 2});
    this.first = Math.max(0, firstAtLeast(this.times, view.from) - 1);
    this.end = Math.min(this.times.length, firstAtLeast(this.times, view.to) + 1);
    this.setRange();
    this.drawAxes(bottom);
    if (this.until < view.to) {
      const x = Math.max(this.x(this.until), LEFT);
      add(svg, "rect",
        {fill: `url(#${this.id}-unknown)`, x: pixel(x), y: HEIGHT.top, width: pixel(this.right - x), height: HEIGHT.plot});
    }
    const inside = add(svg, "g", {"clip-path": `url(#${this.id}-clip)`});
    this.drawBounds(inside);
    HealthPlotValues.draw(this, inside, bottom, add);
    HealthPlotAhead.draw(this, inside, add);
    this.drawBoundNames();
    this.drawStrip(bottom + HEIGHT.gap);
    this.drawAlerts(bottom);
    this.overlay = add(svg, "g");
    this.drawCursor();
    this.all.disabled = view.isWhole;
    this.zoomOut.disabled = view.isWhole && !view.beyond;
    svg.setAttribute("aria-label", this.description());
  }

  description() {
    const {signal} = this;
    const count = signal.alerts.filter((alert) => alert.level !== "OK").length;
    const alerts = count ? `, ${count} ${count === 1 ? "alert" : "alerts"}` : "";
    const range = this.times.length ? `${withUnit(numberText(this.dataLow), signal.unit)} to ` +
      `${withUnit(numberText(this.dataHigh), signal.unit)}` : "no samples";
    const line = HealthPlotAhead.chosen(this), outlook = line && line.text ? `, ${line.text}` : "";
    return `${signal.name}: ${range}${alerts}${outlook}. ` +
      "Keys: plus and minus zoom, arrows move, 0 shows all.";
  }

  setRange() {
    const {signal} = this;
    let low = Infinity, high = -Infinity;
    for (let at = this.first; at < this.end; at++) {
      low = Math.min(low, signal.low[at]);
      high = Math.max(high, signal.high[at]);
    }
    this.dataLow = low;
    this.dataHigh = high;
    for (const bound of signal.bounds) {
      low = Math.min(low, bound.value, bound.clears);
      high = Math.max(high, bound.value, bound.clears);
    }
    [low, high] = HealthPlotAhead.widened(this, low, high);
    if (low > high) [low, high] = [0, 1];
    const room = (high - low) * 0.12 || Math.max(Math.abs(high), 1) * 0.1;
    this.lowest = low - room;
    this.highest = high + room;
  }

  drawAxes(bottom) {
    const {svg, view, signal, right} = this, unit = signal.unit.length <= LONGEST_UNIT ? signal.unit : "";
    const step = niceStep(this.highest - this.lowest, 6);
    for (let value = Math.ceil(this.lowest / step) * step; value <= this.highest; value += step) {
      const y = pixel(this.y(value));
      add(svg, "line", {class: "grid", x1: LEFT, x2: right, y1: y, y2: y});
      add(svg, "text", {x: LEFT - 6, y: Number(y) + 4, "text-anchor": "end"}, withUnit(numberText(Number(value.toFixed(12))), unit));
    }
    if (!unit) add(svg, "text", {x: 0, y: 10}, shortened(signal.unit, (right - LEFT) / CHARACTER));
    const span = view.to - view.from;
    const time = STEPS.find((each) => span / each <= Math.max(2, (right - LEFT) / 90)) || STEPS.at(-1);
    const axis = bottom + HEIGHT.gap + HEIGHT.strip + 15;
    let first = true, free = LEFT;
    for (let t = Math.ceil((view.from + view.utcOffset) / time) * time - view.utcOffset; t <= view.to; t += time) {
      const x = this.x(t);
      add(svg, "line", {class: "grid", x1: pixel(x), x2: pixel(x), y1: HEIGHT.top, y2: bottom});
      const withDate = time >= 86400 || (first && x > LEFT + 50 && x < right - 60);
      const text = time >= 86400 ? timeText(t, view.utcOffset, time, true).slice(0, 10)
        : timeText(t, view.utcOffset, time, withDate);
      const half = text.length * 3.2;
      if (x > right - 24 || x < LEFT + 10 || x - half < free) continue;
      add(svg, "text", {x: pixel(x), y: axis, "text-anchor": "middle"}, text);
      first = false;
      free = x + half;
    }
  }

  /** Makes room for the names of the bounds: in one line each, or two where it is narrow. */
  setBoundNames() {
    const {signal, width} = this, most = width < NARROW ? 11 : 26;
    this.boundNames = signal.bounds.map((bound) => {
      const value = `${bound.side} ${withUnit(numberText(bound.value), signal.unit)}`;
      const lines = width < NARROW ? [bound.level, value] : [`${bound.level} ${value}`];
      return {bound, text: `${bound.level} ${value}`, lines: lines.map((line) => shortened(line, most))};
    });
    const longest = Math.max(0, ...this.boundNames.flatMap(({lines}) => lines.map((line) => line.length)));
    this.right = width - RIGHT - (longest ? longest * CHARACTER + 4 : 0);
  }

  drawBounds(parent) {
    for (const bound of this.signal.bounds) {
      const level = bound.level.toLowerCase(), y = this.y(bound.value), clears = this.y(bound.clears);
      if (y !== clears) {
        add(parent, "rect", {class: `band ${level}`, x: LEFT, y: pixel(Math.min(y, clears)), width: pixel(this.right - LEFT),
          height: pixel(Math.abs(y - clears))});
      }
      add(parent, "line", {class: `bound ${level}`, x1: LEFT, x2: pixel(this.right), y1: pixel(y), y2: pixel(y)});
    }
  }

  drawBoundNames() {
    const names = [...this.boundNames].sort((one, other) => other.bound.value - one.bound.value);
    const height = LINE * Math.max(1, ...names.map(({lines}) => lines.length)), bottom = HEIGHT.top + HEIGHT.plot;
    let next = HEIGHT.top;
    const tops = names.map(({bound, lines}) => {
      const top = Math.max(next, this.y(bound.value) - lines.length * LINE / 2);
      next = top + height;
      return top;
    });
    for (let at = names.length - 1, last = bottom; at >= 0; at--) last = tops[at] = Math.min(tops[at], last - height);
    names.forEach(({bound, text, lines}, at) => {
      const name = add(this.svg, "text", {class: `bound-name ${bound.level.toLowerCase()}`});
      lines.forEach((line, row) => {
        if (row) name.append(" ");
        add(name, "tspan", {x: pixel(this.right + 6), y: pixel(tops[at] + (row + 0.8) * LINE)}, line);
      });
      if (lines.join(" ") !== text) add(name, "title", {}, text);
    });
  }

  drawStrip(top) {
    const {svg, view, signal, right} = this;
    const levels = [...signal.levels, [this.until, ""], [Math.max(view.to, this.until), ""]];
    let drawnTo = LEFT, worst = "", began = LEFT;
    const bar = (from, to, level) => {
      if (to <= from) return;
      const height = HEIGHT.strip * STRIP_SHARE[level], y = top + HEIGHT.strip - height;
      const box = {x: pixel(from), y: pixel(y), width: pixel(Math.max(to - from, 1)), height: pixel(height)};
      if (level) add(svg, "rect", {class: `strip ${level.toLowerCase()}`, ...box});
      if (!level || level === "STALE") add(svg, "rect", {fill: `url(#${this.id}-${level ? "hatch" : "unknown"})`, ...box});
      if (level && level !== "OK" && to - from > 44) {
        add(svg, "text", {class: "in-strip", x: pixel((from + to) / 2), y: top + 13.5, "text-anchor": "middle"}, level);
      }
    };
    for (let at = 0; at + 1 < levels.length; at++) {
      const from = clamp(this.x(levels[at][0]), LEFT, right), to = clamp(this.x(levels[at + 1][0]), LEFT, right);
      const level = levels[at][1];
      if (levels[at + 1][0] < view.from || levels[at][0] > view.to) continue;
      if (to - began < 1) {  // narrower than a pixel: the worst level shows
        if (RANK[level] > RANK[worst]) worst = level;
        continue;
      }
      if (worst && from - began < 1 && RANK[worst] > RANK[level]) {
        bar(began, began + 1, worst);
        drawnTo = began + 1;
      }
      bar(Math.max(from, drawnTo), to, level);
      drawnTo = began = to;
      worst = "";
    }
    if (worst) bar(began, began + 1, worst);
    add(svg, "text", {x: LEFT - 6, y: top + 13, "text-anchor": "end"}, "level");
  }

  drawAlerts(bottom) {
    const {view} = this, groups = [];
    for (const alert of this.signal.alerts) {
      if (alert.t < view.from || alert.t > view.to) continue;
      const x = this.x(alert.t), group = groups.at(-1);
      if (group && x - group.x < MARKER_SPACE) {
        group.count++;
        const better = RANK[alert.level] > RANK[group.alert.level] && group.alert.id !== this.picked;
        if (better || alert.id === this.picked) group.alert = alert;
      } else {
        groups.push({x, alert, count: 1});
      }
    }
    for (const {x, alert, count} of groups) {
      const level = alert.level.toLowerCase(), y = HEIGHT.top - 7;
      add(this.svg, "line",
        {class: `alert-line ${level}`, x1: pixel(x), x2: pixel(x), y1: HEIGHT.top, y2: bottom});
      const link = add(this.svg, "a", {href: `#${encodeURIComponent(alert.id)}`});
      if (alert.id === this.picked) link.setAttribute("class", "picked");
      add(link, "title", {}, count > 1 ? `${alert.text} (and ${count - 1} more here)` : alert.text);
      add(link, "rect", {x: pixel(x - 9), y: 0, width: 18, height: HEIGHT.top, fill: "transparent"});
      const shapes = {
        OK: `M${x - 4} ${y}a4 4 0 1 0 8 0a4 4 0 1 0 -8 0z`,
        WARN: `M${x} ${y - 6}l6 11h-12z`,
        ERROR: `M${x - 5} ${y - 5}h10v10h-10z`,
        STALE: `M${x} ${y - 6}l6 6l-6 6l-6 -6z`,
      };
      add(link, "path", {class: `marker ${level}`, d: shapes[alert.level] || shapes.OK});
    }
  }

  drawCursor() {
    this.overlay.replaceChildren();
    const {signal, view} = this;
    if (this.at === null || this.at < view.from || this.at > view.to) {
      this.say("");
      return;
    }
    let at = firstAtLeast(this.times, this.at);
    if (at > 0 && (at === this.times.length || this.at - this.times[at - 1] < this.times[at] - this.at)) at--;
    const near = at < this.times.length && this.at <= Math.max(this.until, this.times[at]) &&
      Math.abs(this.times[at] - this.at) <= Math.max(signal.gap || Infinity, signal.width * 2);
    const t = near && Math.abs(this.x(this.times[at]) - this.x(this.at)) < 12 ? this.times[at] : this.at;
    const x = pixel(this.x(t));
    add(this.overlay, "line",
      {class: "cursor", x1: x, x2: x, y1: HEIGHT.top, y2: HEIGHT.top + HEIGHT.plot + HEIGHT.gap + HEIGHT.strip});
    const precision = Math.max(signal.width, (view.to - view.from) / 1000) < 0.5 ? 0.1 : 1;
    const parts = [timeText(t, view.utcOffset, precision, true)];
    if (near) {
      const low = signal.low[at], high = signal.high[at];
      for (const value of new Set([low, high])) add(this.overlay, "circle", {class: "dot", cx: x, cy: this.y(value), r: 3.5});
      parts.push(low === high ? withUnit(numberText(low), signal.unit)
        : `${numberText(low)} to ${withUnit(numberText(high), signal.unit)}`);
      parts.push(this.levelAt(t) || "unknown");
    } else {
      const ahead = HealthPlotAhead.valueAt(this, t);
      if (ahead !== null) add(this.overlay, "circle", {class: "dot", cx: x, cy: this.y(ahead), r: 3.5});
      parts.push(ahead === null ? "no sample" : `forecast ${withUnit(numberText(ahead), signal.unit)}`);
      if (t <= this.until) parts.push(this.levelAt(t) || "unknown");
    }
    this.say(parts.join(" · "));
  }

  /** Shows a text beside the buttons; screen readers read each change. */
  say(text) {
    if (this.output.textContent !== text) this.output.textContent = text;
  }

  drawSelection(pointer) {
    const [from, to] = this.selection(pointer);
    add(this.overlay, "rect",
      {class: "selection", x: pixel(from), y: HEIGHT.top, width: pixel(to - from), height: HEIGHT.plot});
  }

  inside(x) { return clamp(x, LEFT, this.right); }
}

// On paper, texts would shrink with the width of the plot.
for (const [event, width] of [["beforeprint", PAPER_WIDTH], ["afterprint", 0]]) {
  addEventListener(event, () => document.querySelectorAll(".plot").forEach(({plot}) => plot && plot.draw(width)));
}

return {Plot, View: HealthPlotViews.View, add, clamp, timeText};
})();
