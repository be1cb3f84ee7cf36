/* How far a plot reaches back: the live window, or stored samples of the last 10 minutes to 30 days. */
import {make, setAttribute, setText} from "./elements.js";
import {request} from "./connection.js";

/** Name, length and period of the samples, in s; the first is the live window. */
const RANGES = [["Live", 0, 0], ["10 min", 600, 10], ["1 hour", 3600, 10], ["24 hours", 86400, 120], ["7 days", 604800, 900], ["30 days", 2592000, 3600]];
const RETRY_MS = 10000;

/** Returns the stored samples of a span, in s since 1970, in periods of `seconds`. */
export async function requestSamples(robot, signal, seconds, from, to = Infinity) {
  const query = new URLSearchParams({robot, signal, seconds, from: new Date(from * 1000).toISOString()});
  if (to < Infinity) query.set("to", new Date(to * 1000).toISOString());
  return (await request(`api/history/samples?${query}`)).samples;
}

/** Returns stored samples, as in the API, in the form that the plot takes; `now` in s since 1970. */
export function stored(samples, [, length, width], now) {
  const start = samples.length ? Date.parse(samples[0].start) / 1000 : 0, places = [], low = [], high = [], mean = [], bad = [], levels = [];
  let end = -Infinity;
  for (const sample of samples) {
    const t = Date.parse(sample.start) / 1000;
    if (levels.length && end < t) levels.push([end, ""]);  // nothing is known of the time between
    if (!levels.length || levels.at(-1)[1] !== sample.level) levels.push([t, sample.level]);
    end = t + Math.max(width, sample.seconds);
    if (sample.bad) bad.push(t + width / 2);
    if (sample.min === null) continue;
    places.push(Math.round((t - start) / width));
    low.push(sample.min);
    high.push(sample.max);
    mean.push(sample.mean);
  }
  if (samples.length) levels.push([end, ""]);
  const steps = places.map((place, at) => place - (at ? places[at - 1] : -1));
  const usual = [...steps.slice(1)].sort((one, other) => one - other)[steps.length >> 1] || 1;
  return {from: now - length, length, data: {start, width, steps, low, high, mean, bad, gap: Math.max(2.5, 5 * (usual - 1)) * width}, levels};
}

export class Ranges {
  /** `show` takes what `stored` returns; null: the live window. */
  constructor(page, robot, signal, show) {
    Object.assign(this, {page, robot, signal, show, at: 0, loadAt: Infinity});
    this.buttons = RANGES.map(([name], at) => make("button", {onclick: () => this.choose(at)}, name));
    this.problem = make("span.error-text", {role: "status"});
    this.element = make("div.ranges", {role: "group", "aria-label": "Range of the plot"}, ...this.buttons, this.problem);
    this.mark();
  }

  mark() {
    this.buttons.forEach((button, at) => setAttribute(button, "aria-pressed", String(at === this.at)));
  }

  choose(at) {
    this.at = at;
    this.mark();
    this.loadAt = Infinity;
    setText(this.problem, "");
    if (at) this.load();
    else this.show(null);
  }

  widen() {
    if (this.at + 1 === RANGES.length) return false;
    this.choose(this.at + 1);
    return true;
  }

  async load() {
    const range = RANGES[this.at], {now} = this.page.fleet;
    this.loadAt = now + Math.max(range[2], 10) * 1000;
    try {
      const samples = await requestSamples(this.robot, this.signal, range[2], now / 1000 - range[1]);
      if (range !== RANGES[this.at]) return;
      this.show(stored(samples, range, now / 1000));
      setText(this.problem, "");
    } catch (error) {
      if (range !== RANGES[this.at]) return;
      setText(this.problem, `The history cannot be read: ${error.message}`);
      this.loadAt = now + RETRY_MS;
    }
  }

  refresh() {
    if (this.at && this.page.fleet.now >= this.loadAt) this.load();
  }
}
