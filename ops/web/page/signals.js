/* The signals of one robot: a table, and for each opened signal its plot, settings and alerts. */
import {AlertTable} from "./alerts.js";
import {isolated, make, makeCell, makeRow, makeTable, setAttribute, setChildren, setText, shape, silencedMark} from "./elements.js";
import {request} from "./connection.js";
import {patternOf, showAge, valueText, withUnits, withHint} from "./format.js";
import {Badge, LINK, isAlert, rankOf} from "./levels.js";
import {WindowPlot, drawSpark} from "./plots.js";
import {Ranges} from "./ranges.js";

const MOST_PAST = 300;
/** More healthy elements of an array are folded. */
const MOST_ELEMENTS = 8;
let details = 0;

class SignalDetails {
  constructor(robotName, name, page) {
    Object.assign(this, {page, robotName, name});
    this.plotBox = make("div.plot");
    this.ranges = new Ranges(page, robotName, name, (stored) => {
      this.plot.setStored(stored);
      this.draw();
    });
    this.plot = new WindowPlot(this.plotBox, name, () => this.ranges.widen());
    this.facts = make("p.facts");
    this.silenced = make("p");
    this.silence = make("button", {onclick: () => page.actions.silence(robotName, name, isAlert(this.kind) && this.signal)}, "Silence…");
    this.only = {robot: patternOf(robotName), signal: patternOf(name)};
    this.alerts = new AlertTable(page, {only: this.only, size: 5, ofSignal: true});
    this.element = make("div.signal-body", this.ranges.element, this.plotBox, this.facts, this.silenced, make("div.buttons", this.silence),
      make("h4", "Alerts"), this.alerts.element);
  }

  update(signal, kind) {
    if (signal.since !== this.since) {
      this.alerts.load();
      this.loadPast();
    }
    this.since = signal.since;
    setText(this.facts, factsText(signal));
    this.silenced.hidden = !signal.silenced;
    setText(this.silenced, `Silenced: ${signal.silenced}`);
  }

  draw(signal = this.signal, kind = this.kind, samples = this.samples) {
    Object.assign(this, {signal, kind, samples});
    this.ranges.refresh();
    this.plot.show(signal, kind, samples, this.page.fleet.now / 1000);
  }

  async loadPast() {
    const answer = await request(`api/history?${new URLSearchParams({...this.only, limit: MOST_PAST})}`).catch(() => null);
    if (answer) this.plot.setPast(answer.alerts.map((alert) => ({...alert, element: this.alerts.idOf(alert)})), answer.gaps || []);
  }
}

function factsText(signal) {
  const facts = [];
  if (signal.statistic && signal.statistic !== "last") {
    facts.push(`bounds apply to ${signal.statistic}: ${valueText(signal.judged, signal.judged_unit) || "undefined"}`);
  }
  if ((signal.forecast ?? null) !== null) {
    const trend = Number(signal.trend_per_min.toPrecision(3));
    facts.push(`latest value ${valueText(signal.value, signal.unit)}`, `trend ${valueText(trend, `${signal.unit}/min`)}`);
  }
  for (const bound of signal.bounds || []) {
    const clears = bound.clears === bound.value ? "" : ` (clears at ${valueText(bound.clears, signal.judged_unit)})`;
    facts.push(`${bound.level} ${bound.side} ${valueText(bound.value, signal.judged_unit)}${clears}`);
  }
  if (signal.flapping) facts.push("flapping: further changes are not announced");
  if (signal.latch) facts.push("an alert stays until it is reset");
  return facts.join(" · ");
}

class SignalRow {
  constructor(table, name, page) {
    Object.assign(this, {page, parent: table, name, details: null});
    this.badge = new Badge("waiting");
    this.value = isolated("");
    this.outlook = isolated("");
    this.message = isolated("");
    this.silenced = silencedMark();
    this.since = make("time");
    this.spark = makeCell("trend", "");
    this.cell = makeCell("", "", 6);
    const id = `signal-${++details}`;
    this.more = makeRow("details", this.cell);
    this.more.id = id;
    this.more.hidden = true;
    this.button = make("button.signal-name", {"aria-expanded": "false", "aria-controls": id}, shape("open"), isolated(name));
    this.element = makeRow("signal", makeCell("level", this.badge.element), make("th", {role: "rowheader", scope: "row"}, this.button),
      makeCell("value", this.value), this.spark, makeCell("reason", make("span", this.message, this.outlook, this.silenced)), makeCell("since", this.since));
    this.element.addEventListener("click", (event) => this.click(event));
  }

  /** Opens the row, unless the click ends a selection of text. */
  click(event) {
    if (event.target.closest("button") || !String(getSelection())) this.toggle();
  }

  toggle() {
    const open = !this.details;
    setAttribute(this.button, "aria-expanded", String(open));
    this.more.hidden = !open;
    this.details = null;
    this.cell.replaceChildren();
    if (!open) return;
    this.details = new SignalDetails(this.parent.robot.name, this.name, this.page);
    this.cell.append(this.details.element);
    this.details.update(this.signal, this.kind);
    this.page.robots.follow(this.parent);
    this.plot();
  }

  update(signal, kind) {
    this.signal = signal;
    this.kind = kind;
    this.badge.show(kind);
    setAttribute(this.element, "class", `signal ${kind}`);
    const text = signal.text ?? valueText(signal.value, signal.unit);
    const value = this.name === LINK && kind === "ok" ? signal.message : this.name === LINK || this.name[0] === "/" ? "" : withUnits(text) || "–";
    setText(this.value, value);
    // The reason of a healthy signal only repeats its value.
    const repeats = kind === "ok" && !signal.hint && withUnits(signal.message || "") === value;
    setText(this.message, repeats ? "" : withHint(signal.message || "", signal.hint));
    setText(this.outlook, (signal.outlook && !repeats ? ", " : "") + withUnits(signal.outlook || ""));
    this.silenced.hidden = !signal.silenced || !isAlert(kind);
    setAttribute(this.silenced, "title", signal.silenced);
    if (this.details) this.details.update(signal, kind);
    this.tick();
  }

  plot() {
    if (!this.element.isConnected) return;
    const samples = this.parent.samples.get(this.name) || [];
    if (!this.parent.arrayNames.has(this.name)) this.spark.replaceChildren(drawSpark(this.signal, samples));
    if (this.details) this.details.draw(this.signal, this.kind, samples);
  }

  tick() {
    showAge(this.since, Date.parse(this.signal.since), this.page.fleet.now);
  }
}

/** Stands for `names`, which are `what`, if they are more than `most`. */
class FoldRow {
  constructor(table) {
    this.isOpen = false;
    this.button = make("button", {onclick: () => { this.isOpen = !this.isOpen; table.arrange(); }});
    this.element = makeRow("elements", makeCell("", this.button, 6));
  }

  get hidden() { return this.isOpen || !this.isShown ? [] : this.names; }

  get isShown() { return this.names.length > this.most; }

  show() {
    setAttribute(this.button, "aria-expanded", String(this.isOpen));
    setText(this.button, `${this.isOpen ? "Hide" : "Show"} ${this.names.length} ${this.what}`);
  }
}

export class SignalTable {
  constructor(robot, page) {
    this.page = page;
    this.robot = robot;
    this.rows = new Map();
    /** The rows that stand for others, by the name of the array or cause. */
    this.folds = new Map();
    /** Samples in the window of each signal, as [s since 1970, value]. */
    this.samples = new Map();
    Object.assign(this, makeTable("signals", `Signals of ${robot.name}`, ["Level", "Signal", "Value", "Trend", "Reason", "For"]));
  }

  update(robot) {
    this.robot = robot;
    const names = Object.keys(robot.data.signals);
    this.arrayNames = new Set(names.map((name) => name.split("[")).filter((parts) => parts.length > 1).map(([array]) => array));
    for (const name of names) {
      if (!this.rows.has(name)) this.rows.set(name, new SignalRow(this, name, this.page));
      this.rows.get(name).update(robot.data.signals[name], robot.kinds.get(name));
    }
    for (const name of [...this.rows.keys()]) if (!(name in robot.data.signals)) this.rows.delete(name);
    for (const name of [...this.samples.keys()]) if (!this.rows.has(name)) this.samples.delete(name);
    this.arrange();
  }

  /** Sorts the rows, worst first, and folds healthy elements and effects. */
  arrange() {
    const {kinds, data: {signals}} = this.robot, rank = (name) => rankOf(kinds.get(name));
    for (const fold of this.folds.values()) fold.names = [];
    const effects = new Map(), roots = [], elements = [], unplotted = [];
    for (const name of Object.keys(signals)) {
      const [array] = name.split("["), cause = this.robot.causeOf(name), isEffect = cause !== name, by = isEffect ? cause : array;
      if (isEffect) effects.set(by, [...(effects.get(by) || []), name]);
      else roots.push(name);
      if (by === name || !(by in signals) || !isEffect && kinds.get(name) !== "ok" || this.rows.get(name).details) continue;
      const fold = this.folds.get(by) || new FoldRow(this);
      this.folds.set(by, fold);
      (fold.names ||= []).push(name);
      [fold.what, fold.most] = isEffect ? ["affected", 0] : ["elements that are OK", MOST_ELEMENTS];
    }
    const hidden = new Set([...this.folds.values()].flatMap((fold) => fold.hidden));
    const add = (name) => {
      if (hidden.has(name)) return;
      const row = this.rows.get(name), fold = this.folds.get(name);
      elements.push(row.element, row.more);
      if (!row.spark.firstChild) unplotted.push(row);
      if (fold && fold.isShown) elements.push(fold.element);
      if (fold) fold.show();
      (effects.get(name) || []).forEach(add);
    };
    roots.sort((one, other) => rank(one) - rank(other)).forEach(add);
    setChildren(this.body, elements);
    for (const row of unplotted) row.plot();
  }

  tick() {
    for (const row of this.rows.values()) row.tick();
  }

  get opened() { return [...this.rows.values()].filter((row) => row.details); }

  addSamples({full, signals, window_s: windows}) {
    for (const [name, added] of Object.entries(signals)) {
      const samples = full ? [] : this.samples.get(name) || [];
      const last = samples.length ? samples.at(-1)[0] : -Infinity;
      samples.push(...added.filter(([t]) => t > last));
      const end = samples.length ? samples.at(-1)[0] : 0;
      this.samples.set(name, samples.filter(([t]) => t >= end - windows[name]));
    }
    for (const row of this.rows.values()) row.plot();
  }
}
