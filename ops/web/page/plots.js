/* Plots of windows and of alerts, drawn by plot.js (`HealthPlot`), which the replay report uses too. */
import {addSvg} from "./elements.js";
import {utcOffset, withUnits, withHint} from "./format.js";

const RESOLUTION_S = 0.001;
const MOST_LEVELS = 300;
const LEVEL_OF_KIND = {ok: "OK", warn: "WARN", error: "ERROR", stale: "STALE", nolink: "ERROR"};
/** Statistics whose bounds fit into a plot of the values. */
const LIKE_VALUES = new Set(["", "last", "mean", "min", "max", "forecast"]);

/** Returns [s since 1970, value] pairs in the form that the plot takes. */
function columns(samples) {
  const valid = samples.filter(([, value]) => Number.isFinite(value));
  if (!valid.length) return {start: 0, width: RESOLUTION_S, steps: [], low: [], high: []};
  const start = valid[0][0] - RESOLUTION_S / 2;
  const places = valid.map(([t]) => Math.round((t - valid[0][0]) / RESOLUTION_S));
  const values = valid.map(([, value]) => value);
  return {start, width: RESOLUTION_S, steps: places.map((place, at) => place - (at ? places[at - 1] : -1)), low: values, high: values};
}

const seconds = (time) => Date.parse(time) / 1000;

/** Returns the line of a forecast as plots take it, from the newest sample at `t`; null without one. */
function lineAhead(signal, t) {
  const {forecast, trend_per_min: trend, forecast_s: horizon, time_to_bound_s: meets} = signal;
  if ([forecast, trend, horizon].some((each) => !Number.isFinite(each))) return null;
  const at = (after) => [t + after, forecast + trend / 60 * (after - horizon)];
  return {id: "", from: at(0), to: at(horizon), meets: Number.isFinite(meets) && meets <= horizon ? at(meets) : null, text: withUnits(signal.outlook || "")};
}

/** Returns at which distance the line breaks: a few times the usual one. */
function gapOf(samples) {
  if (samples.length < 3) return 0;
  const steps = samples.slice(1).map(([t], at) => t - samples[at][0]).sort((one, other) => one - other);
  return Math.max(5, 5 * steps[steps.length >> 1]);
}

export class WindowPlot {
  constructor(element, name, beyond) {
    Object.assign(this, {element, name, beyond});
    /** Levels that were seen here, as [s since 1970, level]. */
    this.levels = [];
    /** What the history has: levels before that, and alerts. */
    this.past = {levels: [], alerts: []};
    /** Stored samples that are shown in place of the window; null: none. */
    this.stored = null;
  }

  setStored(stored) {
    const length = (each) => (each ? each.length : 0);
    this.isNewRange = length(stored) !== length(this.stored);
    this.stored = stored;
  }

  /** Takes alerts, newest first, each with the id of the `element` that shows it, and when no monitor ran. */
  setPast(alerts, gaps) {
    const oldestFirst = [...alerts].reverse(), changes = [];
    if (oldestFirst.length) changes.push([seconds(oldestFirst[0].since), oldestFirst[0].from_level]);
    for (const {time, to_level: level} of oldestFirst) changes.push([seconds(time), level]);
    const levelAt = (t) => changes.reduce((found, [begin, level]) => (begin <= t ? level : found), "");
    const ends = gaps.flatMap(({from, to}) => [[seconds(from), ""], [seconds(to), levelAt(seconds(to))]]);
    const isKnown = ([t]) => !gaps.some(({from, to}) => seconds(from) <= t && t < seconds(to));
    this.past = {
      levels: [...changes.filter(isKnown), ...ends].sort(([one], [other]) => one - other),
      alerts: oldestFirst.map((alert) => ({id: alert.element, t: seconds(alert.time), level: alert.to_level, text: withHint(alert.text, alert.hint)})),
    };
  }

  show(signal, kind, samples, now) {
    this.noteLevel(signal, kind);
    const common = {name: this.name, unit: withUnits(signal.judged_unit ?? signal.unit ?? ""), bounds: signal.bounds || [], alerts: this.past.alerts};
    const {from, to, ...data} = this.stored ? this.longData(now) : this.windowData(signal, samples, now);
    const shown = {...common, ...data};
    if (!this.plot) {
      this.view = new HealthPlot.View(from, to, utcOffset(now * 1000));
      this.view.beyond = this.beyond;
      this.plot = new HealthPlot.Plot(this.element, shown, this.view);
      return;
    }
    this.view.extend(from, to);
    if (this.isNewRange) [this.view.from, this.view.to, this.isNewRange] = [from, to, false];
    this.plot.update(shown);
  }

  windowData(signal, samples, now) {
    const from = samples.length ? samples[0][0] : now - 60;
    const last = samples.length ? samples.at(-1)[0] : now;
    const until = HealthPlot.clamp(now, last, last + Math.max(60, last - from));  // what is no longer measured stays visible
    const ahead = samples.length ? lineAhead(signal, last) : null;
    const seen = this.levels.length ? this.levels[0][0] : Infinity;
    return {
      from, to: ahead ? Math.max(until, ahead.to[0]) : until, until, ...columns(samples), bad: [], gap: gapOf(samples),
      levels: [...this.past.levels.filter(([t]) => t < seen), ...this.levels], ahead: ahead ? [ahead] : [],
    };
  }

  longData(now) {
    const {data, levels, from} = this.stored, until = levels.length ? levels.at(-1)[0] : now;
    return {from, to: Math.max(now, from + 1), until: Math.min(until, now), ...data, levels, ahead: []};
  }

  noteLevel(signal, kind) {
    const {levels} = this, level = LEVEL_OF_KIND[kind] || "", since = seconds(signal.since), last = levels.at(-1) || [];
    if (since < last[0]) levels.length = 0;  // the clock was set back
    else if (level === last[1] || Number.isNaN(since)) return;
    levels.push([since, level]);
    if (levels.length > MOST_LEVELS) levels.shift();
  }
}

export function drawEvidence(element, past) {
  const {alert, samples} = past, time = seconds(alert.time);
  const times = samples.map(([t]) => t).concat(time);
  const [from, to] = [Math.min(...times), Math.max(...times)];
  const room = Math.max((to - from) * 0.03, 0.5);
  const ahead = alert.statistic === "forecast" && lineAhead({...past, forecast: alert.value}, time);
  const signal = {
    name: alert.signal, unit: withUnits(past.unit || ""), ...columns(samples), bad: [], gap: gapOf(samples),
    bounds: LIKE_VALUES.has(alert.statistic) ? past.bounds : [],
    levels: [[seconds(alert.since) || from, alert.from_level], [time, alert.to_level]],
    alerts: [{id: "alert-page", t: time, level: alert.to_level, text: withHint(alert.text, alert.hint)}],
  };
  if (ahead) Object.assign(signal, {until: to, ahead: [ahead]});
  const view = new HealthPlot.View(from - room, (ahead ? ahead.to[0] : to) + room, utcOffset(time * 1000));
  return new HealthPlot.Plot(element, signal, view);
}

const SPARK = {width: 104, height: 26, edge: 3};

export function drawSpark(signal, samples) {
  const {width, height, edge} = SPARK, bounds = signal.bounds || [];
  const svg = addSvg(null, "svg", {class: "spark", viewBox: `0 0 ${width} ${height}`, "aria-hidden": true});
  const valid = samples.filter(([, value]) => Number.isFinite(value));
  if (valid.length < 2) return svg;
  const values = valid.map(([, value]) => value).concat(bounds.map(({value}) => value));
  const [low, high] = [Math.min(...values), Math.max(...values)], [from, to] = [valid[0][0], valid.at(-1)[0]];
  const y = (value) => (high > low ? edge + (high - value) / (high - low) * (height - 2 * edge) : height / 2).toFixed(1);
  const x = (t) => ((t - from) / (to - from || 1) * (width - edge)).toFixed(1);
  const path = (kind, d) => addSvg(svg, "path", {class: kind, d});
  for (const {level, value} of bounds) path(`spark-bound ${level.toLowerCase()}`, `M0 ${y(value)}H${width}`);
  path("spark-line", valid.map(([t, value], at) => `${at ? "L" : "M"}${x(t)} ${y(value)}`).join(""));
  path("spark-end", `M${x(to)} ${y(valid.at(-1)[1])}h0`);
  return svg;
}
