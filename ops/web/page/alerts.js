/* Tables of past alerts, from the history. */
import {request} from "./connection.js";
import {byId, isolated, make, makeCell, makeRow, makeTable, setAttribute, setChildren, setText, silencedMark} from "./elements.js";
import {durationText, fullTimeText, patternOf, timeText, withHint} from "./format.js";
import {Badge, kindOfLevel, rankOf} from "./levels.js";

const PAGE_SIZE = 100;
let tables = 0;

export class AlertTable {
  /** `only`: parameters of /api/history; `size`: how many at a time; `pages`: whether older ones follow. */
  constructor(page, {only = {}, size = PAGE_SIZE, pages = true, ofSignal = false} = {}) {
    Object.assign(this, {page, only, size, pages, ofSignal, rows: new Map(), gaps: [], more: false, loading: false});
    this.id = `alerts-${++tables}`;
    const heads = ["Time", "Level", ...(ofSignal ? [] : ["Robot"]), "Alert", ...(ofSignal ? [] : ["Action"])];
    this.columns = heads.length;
    Object.assign(this, makeTable("alerts", "Alerts, newest first", heads));
    this.table.hidden = true;
    this.note = make("p.note", "loading…");
    this.older = make("button", {hidden: true, onclick: () => this.load(true)}, "Show older");
    this.element = make("div", this.table, this.note, this.older);
  }

  filter(only) {
    this.only = only;
    this.rows.clear();
    this.more = false;
    this.load();
  }

  async load(older = false) {
    this.again = this.loading;
    if (this.loading) return;
    this.loading = true;
    const {only} = this;
    try {
      const answer = await request(`api/history?${this.query(older)}`);
      if (only !== this.only) this.again = true;  // the filter changed meanwhile
      else this.take(answer, older);
    } catch (error) {
      this.tell(`The history cannot be read: ${error.message}`);
    }
    this.loading = false;
    if (this.again) this.load();
  }

  query(older) {
    const query = new URLSearchParams({...this.only, limit: this.size});
    if (older && this.rows.size) query.set("before", Math.min(...this.rows.keys()));
    return query;
  }

  take(answer, older) {
    const {alerts} = answer, most = Math.max(this.size, this.rows.size);
    if (!older && !alerts.some(({id}) => this.rows.has(id))) this.rows.clear();  // those in between are not known
    for (const alert of alerts) if (!this.rows.has(alert.id)) this.rows.set(alert.id, new AlertRow(this, alert));
    if (older || this.rows.size <= alerts.length) this.more = answer.more;
    while (!older && this.rows.size > most) this.more = this.rows.delete(Math.min(...this.rows.keys()));
    for (const gap of answer.gaps || []) if (!this.gaps.some((known) => known.key === gap.from)) this.gaps.push(gapRow(gap, this.columns));
    this.older.hidden = !this.more || !this.pages;
    const shown = [...this.rows.values()];
    const oldest = Math.min(...shown.map((row) => row.time));
    const rows = [...shown, ...this.gaps.filter((gap) => gap.time >= oldest || !this.more)].sort((one, other) => other.time - one.time || other.place - one.place);
    if (!this.pages) {
      const names = this.page.fleet.sorted.map(({name}) => name);
      const place = ({alert}) => (alert ? names.indexOf(alert.robot) * 9 + rankOf(kindOfLevel(alert.to_level)) : 1e6);
      rows.sort((one, other) => place(one) - place(other));
    }
    setChildren(this.body, rows.map(({row}) => row));
    this.table.hidden = !rows.length;
    this.tell(shown.length ? "" : Object.keys(this.only).length ? "No alert matches." : "No alerts.");
    this.refresh();
  }

  /** Updates which alerts are open: the newest of a signal that still has this level. */
  refresh() {
    const seen = new Set(), {robots} = this.page.fleet;
    for (const row of [...this.rows.values()].sort((one, other) => other.place - one.place)) {
      const {robot, signal, to_level: level} = row.alert, key = JSON.stringify([robot, signal]);
      const of = robots.get(robot), now = of && of.data.signals[signal];
      row.showOpen(!seen.has(key) && level !== "OK" && now && now.level === level ? now : null);
      seen.add(key);
    }
  }

  idOf(alert) {
    return this.rows.has(alert.id) ? this.rows.get(alert.id).id : "alerts";
  }

  tell(text) {
    setText(this.note, text);
    this.note.hidden = !text;
  }
}

class AlertRow {
  constructor(table, alert) {
    this.page = table.page;
    this.alert = alert;
    this.time = Date.parse(alert.time);
    this.place = alert.id;
    this.id = `${table.id}-${alert.id}`;
    const {now} = this.page.fleet;
    this.silence = make("button", {
      hidden: true, "aria-label": `Silence ${alert.signal} of ${alert.robot}`,
      onclick: () => this.page.actions.silence(alert.robot, alert.signal, this.signal, "resolved"),
    }, "Silence…");
    this.silenced = silencedMark();
    this.row = makeRow("alert",
      makeCell("time", make("time", {datetime: alert.time, title: fullTimeText(this.time)}, timeText(this.time, now))),
      makeCell("level", new Badge(kindOfLevel(alert.to_level)).element),
      table.ofSignal ? null : makeCell("robot-cell", this.robotLink(alert.robot)),
      makeCell("text", make("a", {href: `#alerts/${alert.id}`}, isolated(withHint(alert.text, alert.hint)))), table.ofSignal ? null : makeCell("action", make("span", this.silence, this.silenced)));
    this.row.id = this.id;
  }

  /** `signal` is as in the API; null: the alert is not open. */
  showOpen(signal) {
    this.signal = signal;
    setAttribute(this.row, "class", `alert${signal ? " open" : ""}`);
    this.silence.hidden = !signal || Boolean(signal.silenced);
    this.silenced.hidden = !signal || !signal.silenced;
    setAttribute(this.silenced, "title", signal && signal.silenced);
  }

  robotLink(name) {
    return make("a", {href: `#robots/${encodeURIComponent(name)}`}, isolated(name));
  }
}

function gapRow(gap, columns) {
  const from = Date.parse(gap.from), time = Date.parse(gap.to);
  const text = `no monitor ran for ${durationText((time - from) / 1000)}, from ${fullTimeText(from)}`;
  return {key: gap.from, time, place: 0, row: makeRow("gap", makeCell("", text, columns))};
}

const TYPING_MS = 300;

export class AlertView {
  constructor(page) {
    this.table = new AlertTable(page);
    byId("alert-history").append(this.table.element);
    this.form = byId("alert-filter");
    this.form.addEventListener("submit", (event) => event.preventDefault());
    const apply = () => {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.table.filter(this.only), TYPING_MS);
    };
    for (const event of ["input", "change"]) this.form.addEventListener(event, apply);
  }

  get only() {
    const {robot, signal, level, open} = this.form.elements, only = {};
    for (const {name, value} of [robot, signal]) if (value.trim()) only[name] = `*${patternOf(value.trim(), "*?")}*`;
    if (level.value) only.level = level.value;
    if (open.checked) only.open = 1;
    return only;
  }
}
