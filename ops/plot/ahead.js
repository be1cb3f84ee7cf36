/* Lines of forecasts: dotted ahead to the horizon, with a mark where a line meets a bound.

   A line is {id, from: [t, value], to: [t, value], meets: [t, value] or null, text}: it goes from the newest sample of
   its forecast through the mark to the forecast; `id` is that of the alert that it gave, or "". plot.js follows. */
const HealthPlotAhead = (() => {
const SPACE = 30, CHARACTER = 7.2;  // pixels

const points = ({from, meets, to}) => meets ? [from, meets, to] : [from, to];
const inView = ({signal, view}) => (signal.ahead || []).filter(({from, to}) => to[0] >= view.from && from[0] <= view.to);

/** Returns the line of the picked alert, else the latest; undefined: there is none. */
function chosen(plot) {
  const lines = inView(plot);
  return lines.find(({id}) => id && id === plot.picked) || lines.at(-1);
}

/** Returns the range, widened for the chosen line by at most its own height each way. */
function widened(plot, low, high) {
  const line = chosen(plot);
  if (!line) return [low, high];
  const ends = [line.from[1], line.to[1]], room = high > low ? high - low : Infinity;
  return [Math.max(Math.min(low, ...ends), low - room), Math.min(Math.max(high, ...ends), high + room)];
}

/** Returns the value of the chosen line at a time; null: it has none. */
function valueAt(plot, t) {
  const line = chosen(plot), all = line ? points(line) : [], place = all.findIndex(([end]) => t <= end);
  if (place < 1) return null;
  const [[begin, first], [end, last]] = all.slice(place - 1);
  return first + (t - begin) / (end - begin) * (last - first);
}

/** Draws the lines; of those that begin close to each other only the first, and the chosen one with its text. */
function draw(plot, parent, add) {
  const {left, right, top, bottom, signal, view} = plot, strong = chosen(plot);
  const point = ([t, value]) => `${plot.x(t).toFixed(1)} ${plot.y(value).toFixed(1)}`;
  let last = -Infinity;
  for (const line of inView(plot)) {
    const begin = plot.x(line.from[0]);
    if (line !== strong && begin - last < SPACE) continue;
    last = begin;
    add(parent, "path", {class: line === strong ? "ahead chosen" : "ahead", d: `M${points(line).map(point).join("L")}`});
  }
  const [t, value] = strong ? strong.meets || strong.to : [NaN];
  if (!(t >= view.from && t <= view.to)) return;
  const x = plot.x(t), y = Math.min(Math.max(plot.y(value), top), bottom), distance = (bound) => Math.abs(bound.value - value);
  if (strong.meets) {
    const [bound] = [...signal.bounds].sort((one, other) => distance(one) - distance(other));
    add(parent, "circle", {class: `meets ${bound ? bound.level.toLowerCase() : ""}`, cx: x, cy: y, r: 5});
  }
  // The text is left of the mark, on the side from which the line does not come.
  const half = Math.min(strong.text.length * CHARACTER, right - left) / 2;
  const above = strong.to[1] < strong.from[1] ? y + 22 > bottom : y - 22 > top;
  const place = {x: Math.min(Math.max(x, left + 2 * half), right) - half, y: above ? y - 12 : y + 22};
  if (strong.text) add(parent, "text", {class: "ahead-text", "text-anchor": "middle", ...place}, strong.text);
}

return {chosen, draw, valueAt, widened};
})();
