/* Plots of windows and of the evidence of alerts, drawn by plot.js (`HealthPlot`), which the replay report uses too. */
import {utcOffset, withHint} from "./format.js";

/* global HealthPlot */

const RESOLUTION_S = 0.001;
const MOST_LEVELS = 300;
const LEVEL_OF_KIND = {ok: "OK", warn: "WARN", error: "ERROR", stale: "STALE", nolink: "ERROR"};
/** Statistics that have the unit and the range of the values, so that their bounds fit into a plot of the values. */
const LIKE_VALUES = new Set(["last", "mean", "min", "max"]);

/** Returns samples, [s since 1970, value] pairs, in the form that the plot takes. */
function columns(samples) {
  const valid = samples.filter(([, value]) => Number.isFinite(value));
  if (!valid.length) return {start: 0, width: RESOLUTION_S, steps: [], low: [], high: []};
  const start = valid[0][0] - RESOLUTION_S / 2;
  const places = valid.map(([t]) => Math.round((t - valid[0][0]) / RESOLUTION_S));
  const values = valid.map(([, value]) => value);
  return {start, width: RESOLUTION_S, steps: places.map((place, at) => place - (at ? places[at - 1] : -1)), low: values, high: values};
}

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

function boundsOf(signal) {
  return LIKE_VALUES.has(signal.statistic || "last") ? signal.bounds || [] : [];
}

/** Returns the distance at which the line breaks: a few times the usual one. */
function gapOf(samples) {
  if (samples.length < 3) return 0;
  const steps = samples.slice(1).map(([t], at) => t - samples[at][0]).sort((one, other) => one - other);
  return Math.max(5, 5 * steps[steps.length >> 1]);
}

/** The live plot of a signal's window. */
export class WindowPlot {
  constructor(element, name) {
    this.element = element;
    this.name = name;
    this.levels = [];
  }

  /** Shows a signal with these samples, up to `now` in s since 1970. */
  show(signal, kind, samples, now) {
    this.noteLevel(signal, kind);
    const from = samples.length ? samples[0][0] : now - 60;
    const last = samples.length ? samples[samples.length - 1][0] : now;
    const to = clamp(now, last, last + Math.max(60, last - from));  // what is no longer measured stays visible
    const shown = {
      name: this.name, unit: signal.judged_unit ?? signal.unit ?? "", ...columns(samples), bad: [], gap: gapOf(samples), bounds: signal.bounds || [],
      levels: this.levels, alerts: [],
    };
    if (this.plot) {
      this.view.extend(from, to);
      this.plot.update(shown);
    } else {
      this.view = new HealthPlot.View(from, to, utcOffset(to * 1000));
      this.plot = new HealthPlot.Plot(this.element, shown, this.view);
    }
  }

  /** Keeps the levels as far as they were seen here; what was before is unknown. */
  noteLevel(signal, kind) {
    const level = LEVEL_OF_KIND[kind] || "", last = this.levels[this.levels.length - 1];
    if (last && last[1] === level) return;
    const since = Date.parse(signal.since) / 1000;
    if (!Number.isNaN(since)) this.levels.push([Math.max(since, last ? last[0] : -Infinity), level]);
    if (this.levels.length > MOST_LEVELS) this.levels.shift();
  }
}

/** Draws the evidence of an alert: `past` is the answer of /api/history/ID, `id` the id of the element that shows it. */
export function drawEvidence(element, past, id) {
  const {alert, samples} = past, time = Date.parse(alert.time) / 1000;
  const times = samples.map(([t]) => t).concat(time);
  const [from, to] = [Math.min(...times), Math.max(...times)];
  const room = Math.max((to - from) * 0.03, 0.5);
  const signal = {
    name: alert.signal, unit: past.unit || "", ...columns(samples), bad: [], gap: gapOf(samples),
    bounds: boundsOf({statistic: alert.statistic, bounds: past.bounds}),
    levels: [[Date.parse(alert.since) / 1000 || from, alert.from_level], [time, alert.to_level]],
    alerts: [{id, t: time, level: alert.to_level, text: withHint(alert.text, alert.hint)}],
  };
  const view = new HealthPlot.View(from - room, to + room, utcOffset(time * 1000));
  return new HealthPlot.Plot(element, signal, view);
}
