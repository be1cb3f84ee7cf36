/* The state of all robots, as the last events gave it. Knows nothing of the page. */
import {withHint} from "./format.js";
import {LINK, isAlert, kindOfLevel, kindOfSignal, rankOf} from "./levels.js";

const NAMES = new Intl.Collator("en", {numeric: true});

const reasonOf = ([name, signal]) => `${name}: ${withHint(signal.message, signal.hint)}`;

/** `data` is as in the API; all else is derived from it. */
class Robot {
  constructor(name) {
    this.name = name;
    this.data = {signals: Object.create(null)};  // any name is possible, also __proto__
    this.kinds = new Map();
  }

  /** Returns the names of the signals whose kind changed, if only for a moment. */
  merge(change) {
    const {signals, ...others} = change;
    Object.assign(this.data, others);
    const changed = [];
    for (const [name, values] of Object.entries(signals || {})) {
      const signal = Object.assign(this.data.signals[name] || (this.data.signals[name] = {}), values);
      const kind = kindOfSignal(name, signal);
      if (kind !== this.kinds.get(name) || values.since) changed.push(name);
      this.kinds.set(name, kind);
    }
    this.judge();
    return changed;
  }

  judge() {
    const signals = Object.entries(this.data.signals);
    /** The signals that are not OK, worst first, as [name, signal]; without the effects of another one. */
    this.bad = signals.filter(([name]) => this.kinds.get(name) !== "ok" && this.causeOf(name) === name)
      .sort(([one], [other]) => rankOf(this.kinds.get(one)) - rankOf(this.kinds.get(other)));
    /** How many more; none while the link is down. */
    this.others = this.kinds.get(LINK) === "nolink" ? 0 : Math.max(0, this.bad.length - 1);
    this.silenced = signals.filter(([name, signal]) => signal.silenced && isAlert(this.kinds.get(name))).length;
    this.kind = this.bad.length ? this.kinds.get(this.bad[0][0]) : this.isEmpty ? "waiting" : "ok";
  }

  /** Returns the first cause of what a signal suffers from, itself if there is none. */
  causeOf(name) {
    const {signals} = this.data, seen = new Set();
    for (let cause = name; cause in signals && !seen.has(cause); cause = signals[cause].cause) seen.add(name = cause);
    return name;
  }

  get isEmpty() { return Object.keys(this.data.signals).every((name) => name === LINK); }

  get cause() { return this.bad.length ? reasonOf(this.bad[0]) : ""; }

  /** Begin of the level, in ms since 1970; NaN if unknown. */
  get since() {
    const signals = this.bad.length ? [this.bad[0][1]] : Object.values(this.data.signals);
    return Math.max(...signals.map((signal) => Date.parse(signal.since)));
  }

  matches(text) {
    if (!text || this.name.toLowerCase().includes(text)) return true;
    return this.bad.some((each) => reasonOf(each).toLowerCase().replaceAll("\u00a0", " ").includes(text));
  }
}

export class Fleet {
  constructor() {
    this.robots = new Map();
    this.state = {silences: []};
    this.clockOffset = NaN;
  }

  get monitorKind() { return this.state.monitor ? kindOfLevel(this.state.monitor.level) : "ok"; }

  /** The faults of the monitor itself, one text each, worst first. */
  get faults() {
    const rank = (fault) => rankOf(kindOfLevel(fault.level)), faults = this.state.monitor ? this.state.monitor.faults : [];
    return [...faults].sort((one, other) => rank(one) - rank(other))
      .map(({robot, part, level, text}) => `Monitor ${level}: ${robot && this.robots.size > 1 ? `${robot}: ` : ""}${part}: ${text}`);
  }

  /** The monitor's time, in ms since 1970; the browser's may differ. */
  get now() { return performance.now() + this.clockOffset; }

  replace(state) {
    this.state = {silences: []};
    this.robots = new Map();
    return this.merge(state);
  }

  /** Returns the names of changed robots, the [robot, signal] of new kinds, and whether to sort again. */
  merge(change) {
    const {robots, ...others} = change;
    Object.assign(this.state, others);
    this.setClock(change.now);
    const names = new Set(), alerts = [];
    let order = false;
    for (const [name, data] of Object.entries(robots || {})) {
      let robot = this.robots.get(name);
      if (!robot) this.robots.set(name, robot = new Robot(name));
      const kind = robot.kind;
      for (const signal of robot.merge(data)) alerts.push([robot, signal]);
      if (robot.kind !== kind) order = true;
      names.add(name);
    }
    return {names, alerts, order};
  }

  setClock(now) {
    const time = Date.parse(now);
    if (!Number.isNaN(time)) this.clockOffset = time - performance.now();
  }

  get sorted() {
    return [...this.robots.values()].sort((one, other) => rankOf(one.kind) - rankOf(other.kind) || NAMES.compare(one.name, other.name));
  }

  /** How many robots there are of each kind that there is, worst first. */
  get counts() {
    const counts = new Map();
    for (const {kind} of this.sorted) counts.set(kind, (counts.get(kind) || 0) + 1);
    return counts;
  }
}
