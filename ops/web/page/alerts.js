/* Tables of past alerts, from the history. */
import {request} from "./connection.js";
import {isolated, make, makeCell, makeRow, makeTable, setAttribute, setChildren, setText, shape} from "./elements.js";
import {durationText, fullTimeText, patternOf, timeText, withHint} from "./format.js";
import {Badge, kindOfLevel} from "./levels.js";
import {drawEvidence} from "./plots.js";

const PAGE_SIZE = 100;
let tables = 0;

/** A table of alerts, newest first, each with its evidence on request. */
export class AlertTable {
  /** @param {{robot: ?string, signal: ?string}} only - only these alerts; `size`: how many at a time. */
  constructor(page, only, size = PAGE_SIZE) {
    this.page = page;
    this.only = only;
    this.size = size;
    this.id = `alerts-${++tables}`;
    this.rows = new Map();
    this.gaps = [];
    this.more = false;
    this.loading = false;
    const heads = ["Time", "Level", ...(only.robot ? [] : ["Robot"]), "Alert"];
    this.columns = heads.length;
    Object.assign(this, makeTable("alerts", "Alerts, newest first", heads));
    this.table.hidden = true;
    this.note = make("p.note", {}, "loading…");
    this.older = make("button", {hidden: true, onclick: () => this.load(true)}, "Show older");
    this.element = make("div", {}, this.table, this.note, this.older);
  }

  /** Fetches the newest alerts, or the ones before the oldest that is shown. */
  async load(older = false) {
    this.again = this.loading;
    if (this.loading) return;
    this.loading = true;
    try {
      if (this.page.fleet.state.history) this.take(await request(`api/history?${this.query(older)}`), older);
      else this.tell("No history: ops.yaml has no section history.");
    } catch (error) {
      this.tell(`The history cannot be read: ${error.message}`);
    }
    this.loading = false;
    if (this.again) this.load();
  }

  query(older) {
    const query = new URLSearchParams({limit: this.size});
    for (const [key, value] of Object.entries(this.only)) query.set(key, patternOf(value));
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
    this.older.hidden = !this.more;
    const shown = [...this.rows.values()];
    const oldest = Math.min(...shown.map((row) => row.time));
    const rows = [...shown, ...this.gaps.filter((gap) => gap.time >= oldest || !this.more)].sort((one, other) => other.time - one.time || other.place - one.place);
    setChildren(this.body, rows.flatMap((row) => row.elements));
    this.table.hidden = !rows.length;
    this.tell(shown.length ? "" : "No alerts.");
  }

  tell(text) {
    setText(this.note, text);
    this.note.hidden = !text;
  }
}

/** One alert; its evidence is below it, once opened. */
class AlertRow {
  constructor(table, alert) {
    this.page = table.page;
    this.alert = alert;
    this.time = Date.parse(alert.time);
    this.place = alert.id;
    this.id = `${table.id}-${alert.id}`;
    this.cell = makeCell("", "", table.columns);
    this.more = makeRow("details", this.cell);
    this.more.hidden = true;
    this.button = make("button.evidence", {"aria-expanded": "false", title: "show the samples at that moment", onclick: () => this.toggle()},
      shape("open"), isolated(withHint(alert.text, alert.hint)));
    const {now} = this.page.fleet;
    this.row = makeRow("alert",
      makeCell("time", make("time", {datetime: alert.time, title: fullTimeText(this.time)}, timeText(this.time, now))),
      makeCell("level", new Badge(kindOfLevel(alert.to_level)).element),
      table.only.robot ? null : makeCell("robot-cell", this.robotLink(alert.robot)),
      makeCell("text", this.button));
    this.row.id = this.id;
    this.elements = [this.row, this.more];
  }

  robotLink(name) {
    return make("a", {href: `#robots/${encodeURIComponent(name)}`}, isolated(name));
  }

  async toggle() {
    const open = this.more.hidden;
    this.more.hidden = !open;
    setAttribute(this.button, "aria-expanded", String(open));
    this.cell.replaceChildren();
    if (!open) return;
    const box = make("div.plot", {}, make("p.note", {}, "loading…"));
    this.cell.append(box);
    try {
      const past = await request(`api/history/${this.alert.id}`);
      box.replaceChildren();
      drawEvidence(box, {...past, alert: {...this.alert, ...past.alert}}, this.id);
    } catch (error) {
      box.replaceChildren(make("p.error-text", {}, `The evidence cannot be read: ${error.message}`));
    }
  }
}

/** Returns a row for a time in which no monitor ran. */
function gapRow(gap, columns) {
  const from = Date.parse(gap.from), time = Date.parse(gap.to);
  const text = `no monitor ran for ${durationText((time - from) / 1000)}, from ${fullTimeText(from)}`;
  return {key: gap.from, time, place: 0, elements: [makeRow("gap", makeCell("", text, columns))]};
}
