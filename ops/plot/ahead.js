/* The lines of forecasts in a plot: dotted ahead to the horizon, with a mark where a line meets a bound.

   A line is {id, from: [t, value], to: [t, value], meets: [t, value] or null, text}: it begins at the newest sample of
   its forecast, `id` is that of the alert that it gave, "" that of none, and `text` may be empty. plot.js follows. */
"use strict";

const HealthPlotAhead = (() => {
const SPACE = 30, CHARACTER = 7.2, MARK = 5;  // pixels

const isInView = ({view}, {from: [from], to: [to]}) => to >= view.from && from <= view.to;

/** Returns the line that stands out: that of the alert that was picked, else the latest; null where there is none. */
function chosen(plot) {
  const lines = (plot.signal.ahead || []).filter((line) => isInView(plot, line));
  return lines.find(({id}) => id && id === plot.picked) || lines[lines.length - 1] || null;
}

/** Returns the range of values, widened for the chosen line: at most to three times its height. */
function widened(plot, low, high) {
  const line = chosen(plot);
  if (!line) return [low, high];
  const ends = [line.from[1], line.to[1]], room = low < high ? high - low : Infinity;
  return low > high ? [Math.min(...ends), Math.max(...ends)]
    : [Math.max(Math.min(low, ...ends), low - room), Math.min(Math.max(high, ...ends), high + room)];
}

/** Returns the value of the chosen line at a time after the newest sample; null where there is none. */
function valueAt(plot, t) {
  const line = chosen(plot);
  if (!line || t <= line.from[0] || t > line.to[0]) return null;
  const [[begin, first], [end, last]] = [line.from, line.to];
  return first + (t - begin) / (end - begin) * (last - first);
}

/** Draws all lines, the chosen one with its mark and text; of lines that begin close to each other only the first. */
function draw(plot, parent, add) {
  const {signal, view, right} = plot, strong = chosen(plot);
  const point = ([t, value]) => `${plot.x(t).toFixed(1)} ${plot.y(value).toFixed(1)}`;
  let last = -Infinity;
  for (const line of signal.ahead || []) {
    const begin = plot.x(line.from[0]);
    if (!isInView(plot, line) || (line !== strong && begin - last < SPACE)) continue;
    last = begin;
    add(parent, "path", {class: line === strong ? "ahead chosen" : "ahead", d: `M${point(line.from)}L${point(line.to)}`});
  }
  if (!strong) return;
  const [t, value] = strong.meets || strong.to;
  if (t < view.from || t > view.to) return;
  const x = plot.x(t), y = Math.min(Math.max(plot.y(value), plot.top), plot.bottom);
  if (strong.meets) {
    const bounds = [...signal.bounds].sort((one, other) => Math.abs(one.value - value) - Math.abs(other.value - value));
    const level = bounds.length ? bounds[0].level.toLowerCase() : "";
    add(parent, "circle", {class: `meets ${level}`, cx: x.toFixed(1), cy: y.toFixed(1), r: MARK});
  }
  if (!strong.text) return;
  const half = Math.min(strong.text.length * CHARACTER, right - plot.left) / 2;
  // To the left, on the side from which the line does not come.
  const middle = Math.min(Math.max(x - half, plot.left + half), right - half);
  const above = strong.to[1] < strong.from[1] ? y + 22 > plot.bottom : y - 12 > plot.top + 10;
  add(parent, "text", {class: "ahead-text", x: middle.toFixed(1), y: (above ? y - 12 : y + 22).toFixed(1), "text-anchor": "middle"}, strong.text);
}

return {chosen, draw, valueAt, widened};
})();
