/* The state of all robots, as the last events gave it. Knows nothing of the page. */
import {withHint} from "./format.js";
import {LINK, kindOfLevel, kindOfSignal, rankOf} from "./levels.js";

const NAMES = new Intl.Collator("en", {numeric: true});

const reasonOf = ([name, signal]) => `${name}: ${withHint(signal.message, signal.hint)}`;

/** One robot. `data` is as in the API; all else is derived from it. */
class Robot {
  constructor(name) {
    this.name = name;
    this.data = {signals: Object.create(null)};  // any name is possible, also __proto__
    /** Kind of each signal. */
    this.kinds = new Map();
  }

  /** Merges what changed, and returns the names of the signals whose kind changed, if only for a moment. */
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
    /** The signals that are not OK, worst first, as [name, signal]. */
    this.bad = signals.filter(([name]) => this.kinds.get(name) !== "ok")
      .sort(([one], [other]) => rankOf(this.kinds.get(one)) - rankOf(this.kinds.get(other)));
    /** How many further signals are not OK. With the link down, all are unknown for that one reason. */
    this.others = this.kinds.get(LINK) === "nolink" ? 0 : Math.max(0, this.bad.length - 1);
    this.silenced = signals.filter(([, signal]) => signal.silenced).length;
    this.kind = this.bad.length ? this.kinds.get(this.bad[0][0]) : this.isEmpty ? "waiting" : "ok";
  }

  /** Whether no signal is watched. */
  get isEmpty() {
    return Object.keys(this.data.signals).every((name) => name === LINK);
  }

  /** The reason for the kind, in one line; empty if OK. */
  get cause() {
    return this.bad.length ? reasonOf(this.bad[0]) : "";
  }

  /** Begin of the level, in ms since 1970; NaN if unknown. */
  get since() {
    const signals = this.bad.length ? [this.bad[0][1]] : Object.values(this.data.signals);
    return Math.max(...signals.map((signal) => Date.parse(signal.since)));
  }

  /** Whether the filter text is in its name or in a reason. `text` is in lower case. */
  matches(text) {
    if (!text || this.name.toLowerCase().includes(text)) return true;
    return this.bad.some((each) => reasonOf(each).toLowerCase().includes(text));
  }
}

/** All robots, and the monitor's clock. */
export class Fleet {
  constructor() {
    this.robots = new Map();
    this.state = {silences: []};
    this.clockOffset = NaN;
  }

  /** Whether silences can be added. */
  get canSilence() {
    return this.state.can_change && this.state.silencing;
  }

  /** Kind of the monitor itself: that of its worst fault. */
  get monitorKind() {
    return this.state.monitor ? kindOfLevel(this.state.monitor.level) : "ok";
  }

  /** The faults of the monitor itself, one text each, worst first. */
  get faults() {
    const rank = (fault) => rankOf(kindOfLevel(fault.level)), faults = this.state.monitor ? this.state.monitor.faults : [];
    return [...faults].sort((one, other) => rank(one) - rank(other))
      .map(({robot, part, level, text}) => `Monitor ${level}: ${robot && this.robots.size > 1 ? `${robot}: ` : ""}${part}: ${text}`);
  }

  /** The monitor's time, in ms since 1970. The clock of this machine may differ. */
  get now() {
    return performance.now() + this.clockOffset;
  }

  /** Replaces everything by a `state`; returns what `merge` returns. */
  replace(state) {
    this.state = {silences: []};
    this.robots = new Map();
    return this.merge(state);
  }

  /**
   * Merges a `change`. Returns the names of the robots that changed, the signals whose kind changed, as
   * [robot, signal], and whether the order of robots may have changed.
   */
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

  /** The robots, worst first, then by name. */
  get sorted() {
    return [...this.robots.values()].sort((one, other) => rankOf(one.kind) - rankOf(other.kind) || NAMES.compare(one.name, other.name));
  }

  /** How many robots there are of each kind, worst first; kinds without robots are left out. */
  get counts() {
    const counts = new Map();
    for (const {kind} of this.sorted) counts.set(kind, (counts.get(kind) || 0) + 1);
    return counts;
  }
}
