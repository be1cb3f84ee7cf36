/* The list of robots. An event updates only the rows of robots that changed. */
import {addSvg, byId, isolated, make, setAttribute, setChildren, setText, shape, silencedMark} from "./elements.js";
import {countText, showAge, valueText, withUnits} from "./format.js";
import {Badge, KINDS, LINK} from "./levels.js";
import {SignalTable} from "./signals.js";

/** The API sends the samples of at most ten. */
const MOST_PLOTTED = 10;
let rows = 0;

/** Levels of the last 24 hours by their letters, worst first. */
const LETTERS = {E: "error", S: "stale", W: "warn", O: "ok"};
/** Levels differ in height, not in colour alone. */
const HEIGHT = {ok: 4, warn: 8, stale: 10, error: 12};

/** Shows cells, one letter each; `-` is not known and not drawn. */
function showDay(svg, cells) {
  if (svg.cells === cells) return;
  svg.cells = cells;
  svg.setAttribute("viewBox", `0 0 ${cells.length || 1} 12`);
  svg.replaceChildren();
  let x = 0;
  for (const [run] of cells.matchAll(/(.)\1*/g)) {
    const kind = LETTERS[run[0]], height = HEIGHT[kind];
    if (kind) addSvg(svg, "rect", {class: `cell ${kind}`, x, width: run.length, y: 12 - height, height});
    x += run.length;
  }
  const parts = Object.entries({...LETTERS, "-": "unknown"}).filter(([letter]) => cells.includes(letter))
    .map(([letter, kind]) => `${KINDS.get(kind).replace("unreachable", "unknown")} ${(cells.split(letter).length - 1) / 4} h`);
  setAttribute(svg, "aria-label", `last 24 hours: ${parts.join(", ") || "unknown"}`);
}

class RobotRow {
  constructor(robot, page) {
    this.page = page;
    this.badge = new Badge(robot.kind);
    this.reason = isolated("");
    this.silenced = silencedMark();
    this.since = make("time.since");
    this.values = make("span.main-values");
    this.day = addSvg(null, "svg", {class: "day", role: "img", preserveAspectRatio: "none"});
    const id = `robot-${++rows}`;
    this.head = make("button.robot-head", {"aria-expanded": "false", "aria-controls": id, onclick: () => this.toggle()},
      shape("open"), this.badge.element, make("bdi.robot-name", robot.name),
      make("span.cause", this.reason), this.silenced, this.since, this.values, this.day);
    this.body = make("div.robot-body", {id, hidden: true});
    this.element = make("li.robot", make("h3", this.head), this.body);
    this.table = null;
    this.update(robot);
  }

  update(robot) {
    this.robot = robot;
    this.badge.show(robot.kind);
    setAttribute(this.element, "class", `robot ${robot.kind}`);
    const text = robot.isEmpty ? "no signal is watched: run `robot-health init`" : countText(robot.kinds.size, "signal");
    const hasValues = this.showValues(), more = robot.others ? ` and ${robot.others} more` : "";
    setText(this.reason, robot.cause + more || (hasValues ? "" : text));
    this.silenced.hidden = !robot.silenced;
    setText(this.silenced.lastChild, robot.silenced ? `${robot.silenced} silenced` : "");
    this.tick();
    if (this.isOpen) this.updateBody();
  }

  showValues() {
    const {data: {signals, show}, kinds} = this.robot;
    const shown = (show || []).filter((name) => name in signals && name !== LINK && !["waiting", "unknown"].includes(kinds.get(name)));
    setChildren(this.values, shown.map((name) => {
      const {text, value, unit} = signals[name];
      return make("span", isolated(name), " ", make("b", kinds.get(name) === "stale" ? "STALE" : withUnits(text ?? valueText(value, unit)) || "–"), " ");
    }));
    const cells = this.page.robots && this.page.robots.days[this.robot.name];
    setAttribute(this.day, "hidden", cells ? null : "");
    if (cells) showDay(this.day, cells);
    return shown.length > 0;
  }

  updateBody() {
    this.table.update(this.robot);
    this.reset.hidden = !Object.values(this.robot.data.signals).some((signal) => signal.latch);
  }

  tick() {
    showAge(this.since, this.robot.since, this.page.fleet.now);
    if (this.isOpen) this.table.tick();
  }

  get isOpen() { return this.table !== null; }

  toggle(open = !this.isOpen) {
    if (open === this.isOpen) return;
    setAttribute(this.head, "aria-expanded", String(open));
    this.body.hidden = !open;
    this.table = null;
    this.body.replaceChildren();
    if (open) this.fill();
  }

  fill() {
    const actions = this.page.actions, name = this.robot.name;
    this.table = new SignalTable(this.robot, this.page);
    this.page.robots.follow(this.table);
    this.silence = make("button", {onclick: () => actions.silence(name, "*", false)}, "Silence robot…");
    this.reset = make("button.reset", {onclick: () => actions.reset(name)}, "Reset latched alerts…");
    this.body.append(make("div.robot-tools", this.silence, this.reset), this.table.table);
    this.updateBody();
  }
}

export class RobotList {
  constructor(page) {
    this.page = page;
    this.rows = new Map();
    /** The levels of the last 24 hours by robot, a letter per 15 minutes. */
    this.days = Object.create(null);
    this.kinds = new Set();
    this.list = byId("robot-list");
    this.none = byId("no-robot");
    this.input = byId("filter");
    this.input.addEventListener("input", () => this.arrange());
    this.levels = new Map([...KINDS].map(([kind, label]) => [kind, this.levelButton(kind, label)]));
    byId("level-filter").append(...[...this.levels.values()].map(({button}) => button));
  }

  levelButton(kind, label) {
    const count = make("span.number");
    const button = make(`button.level-button.${kind}`, {"aria-pressed": "false", hidden: true, onclick: () => this.toggleKind(kind)},
      shape(kind), count, label);
    return {button, count};
  }

  toggleKind(kind) {
    if (!this.kinds.delete(kind)) this.kinds.add(kind);
    setAttribute(this.levels.get(kind).button, "aria-pressed", String(this.kinds.has(kind)));
    this.arrange();
  }

  update({names, order}, isNew) {
    const {robots} = this.page.fleet;
    for (const name of names) {
      const row = this.rows.get(name);
      if (row) row.update(robots.get(name));
      else this.rows.set(name, new RobotRow(robots.get(name), this.page));
    }
    if (isNew) for (const name of [...this.rows.keys()]) if (!robots.has(name)) this.rows.delete(name);
    if (isNew && robots.size === 1 && !this.wasShown) [...this.rows.values()][0].toggle(true);
    this.wasShown = this.wasShown || isNew;
    // Reasons are filtered too, and they change without a change of the order.
    if (order || isNew || this.input.value || names.size && this.list.childElementCount !== this.rows.size) this.arrange();
  }

  arrange() {
    const {fleet} = this.page, text = this.input.value.trim().toLowerCase();
    const shown = fleet.sorted.filter((robot) => (!this.kinds.size || this.kinds.has(robot.kind)) && robot.matches(text));
    setChildren(this.list, shown.map((robot) => this.rows.get(robot.name).element));
    const {counts} = fleet;
    for (const [kind, {button, count}] of this.levels) {
      button.hidden = !counts.has(kind) && !this.kinds.has(kind);
      setText(count, `${counts.get(kind) || 0}`);
    }
    this.none.hidden = shown.length > 0;
    setText(this.none, fleet.robots.size ? "No robot matches the filter." : "No robot is configured.");
    setAttribute(this.list.parentElement, "class", fleet.robots.size > 1 ? null : "single");
  }

  tick() {
    for (const row of this.rows.values()) row.tick();
  }

  showDays(days) {
    this.days = Object.assign(Object.create(null), days);
    for (const row of this.rows.values()) row.showValues();
  }

  /** Asks for the samples of open robots, first of those with plots; of too many, one closes, but not `latest`. */
  follow(latest) {
    const open = [...this.rows.values()].map((row) => row.table).filter((table) => table);
    const tables = open.filter((table) => table.opened.length);
    if (tables.length > MOST_PLOTTED) {
      const closed = tables.find((table) => table !== latest);
      closed.opened.forEach((signal) => signal.toggle());
      tables.splice(tables.indexOf(closed), 1);
    }
    tables.push(...open.filter((table) => !table.opened.length).slice(0, MOST_PLOTTED - tables.length));
    this.page.connection.follow(tables.map((table) => table.robot.name));
  }

  addSamples(samples) {
    const row = this.rows.get(samples.robot);
    if (row && row.isOpen) row.table.addSamples(samples);
  }

  open(name) {
    const row = this.rows.get(name);
    if (!row) {
      setText(this.none, `There is no robot ${name}.`);
      this.none.hidden = false;
      return;
    }
    this.input.value = "";
    [...this.kinds].forEach((kind) => this.toggleKind(kind));
    this.arrange();
    row.toggle(true);
    row.head.focus({preventScroll: true});
    row.element.scrollIntoView({block: "start"});
  }
}
