/* The values of a plot: a line, or a band with a line; and its bad samples. */
const HealthPlotValues = (() => {
const WIDE = 2;  // pixels: wider buckets are drawn as a band

const pixel = (value) => value.toFixed(1);

function draw(plot, parent, bottom, add) {
  const {signal, view, left, right} = plot;
  const isWide = signal.width / (view.to - view.from) * (right - left) > WIDE;
  const drawn = isWide || signal.mean ? drawBand(plot, parent, add) : drawColumns(plot, parent, add);
  if (!drawn) add(parent, "text", {x: (left + right) / 2, y: bottom / 2 + 9, "text-anchor": "middle"}, "no samples");
  drawDots(plot, parent, add);
  let lastX = -Infinity, crosses = "";
  for (const t of signal.bad) {
    const x = plot.x(t);
    if (x < left || x > right || x - lastX < 4) continue;
    lastX = x;
    crosses += `M${pixel(x - 3)} ${bottom - 9}l6 6m0 -6l-6 6`;
  }
  if (crosses) add(add(parent, "path", {class: "bad", d: crosses}), "title", {}, "bad samples");
}

function breaks({signal, times, first}, at) {
  return at === first || signal.gap > 0 && times[at] - times[at - 1] > Math.max(signal.gap, 2.5 * signal.width);
}

/** Draws the values between two breaks. */
function drawDots(plot, parent, add) {
  const {signal, times, first, end} = plot;
  let dots = "";
  for (let at = first; at < end; at++) {
    if (!breaks(plot, at) || at + 1 < end && !breaks(plot, at + 1)) continue;
    dots += `M${pixel(plot.x(times[at]))} ${pixel(plot.y(signal.high[at]))}h0`;
  }
  if (dots) add(parent, "path", {class: "value alone", d: dots});
}

function drawBand(plot, parent, add) {
  const {signal, times, first, end} = plot;
  const place = (at, value) => `${pixel(plot.x(times[at]))} ${pixel(plot.y(value))}`;
  let band = "", line = "";
  for (let at = first, begin = at; at < end; at++) {
    if (breaks(plot, at)) begin = at;
    if (signal.mean) line += `${at === begin ? "M" : "L"}${place(at, signal.mean[at])}${at === begin ? "h0" : ""}`;
    band += `${at === begin ? "M" : "L"}${place(at, signal.high[at])}`;
    if (at + 1 < end && !breaks(plot, at + 1)) continue;
    for (let back = at; back >= begin; back--) band += `L${place(back, signal.low[back])}`;
    band += "Z";
  }
  add(parent, "path", {class: "value area", d: band || "M0 0"});
  if (line) add(parent, "path", {class: "value", d: line});
  return band;
}

/** Draws one minimum and one maximum per column of pixels, so that no extreme is lost. */
function drawColumns(plot, parent, add) {
  const {signal, times, first, end} = plot;
  let path = "", column = null, lastY = 0, drawing = false;
  const flush = () => {
    if (!column) return;
    const x = pixel(column.x), ends = [plot.y(column.low), plot.y(column.high)];
    if (drawing && Math.abs(ends[1] - lastY) < Math.abs(ends[0] - lastY)) ends.reverse();
    path += drawing ? `L${x} ${pixel(ends[0])}` : `M${x} ${pixel(ends[0])}h0`;
    if (ends[0] !== ends[1]) path += `L${x} ${pixel(ends[1])}`;
    lastY = ends[1];
    drawing = true;
    column = null;
  };
  for (let at = first; at < end; at++) {
    const x = plot.x(times[at]), isGap = breaks(plot, at);
    if (column && (isGap || x - column.x >= 1)) flush();
    if (isGap) drawing = false;
    if (column) {
      column.low = Math.min(column.low, signal.low[at]);
      column.high = Math.max(column.high, signal.high[at]);
    } else {
      column = {x, low: signal.low[at], high: signal.high[at]};
    }
  }
  flush();
  add(parent, "path", {class: "value", d: path || "M0 0"});
  return path;
}

return {draw};
})();
