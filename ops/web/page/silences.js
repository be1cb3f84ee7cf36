/* The view of the silences that have not ended. */
import {byId, isolated, make, makeCell, makeRow, makeTable, setChildren, setText} from "./elements.js";
import {durationText, fullTimeText} from "./format.js";

class SilenceRow {
  constructor(page, silence) {
    this.page = page;
    this.silence = silence;
    this.remaining = make("time", {title: `since ${fullTimeText(Date.parse(silence.since))}`});
    this.button = make("button", {
      "aria-label": `End the silence of ${silence.matchers}`, onclick: () => page.actions.expire(silence),
    }, "End…");
    this.element = makeRow("", makeCell("matchers", isolated(silence.matchers)), makeCell("", isolated(silence.reason)),
      makeCell("author", isolated(silence.author)), makeCell("remaining", this.remaining), makeCell("action", this.button));
  }

  tick() {
    const {fleet} = this.page, {until, until_resolved: untilResolved, every, timezone, in_force: inForce} = this.silence;
    const rule = every ? `every ${every} (${timezone}), ${inForce ? "in force" : "not in force now"}` : "";
    const left = until ? `${durationText(Math.max(0, Date.parse(until) - fleet.now) / 1000)} left` : "";
    setText(this.remaining, rule + (rule && left ? ", " : "") + left + (untilResolved ? `${left ? " or " : ""}until resolved` : ""));
  }
}

export class SilenceList {
  constructor(page) {
    this.page = page;
    this.rows = new Map();
    this.count = byId("silence-count");
    Object.assign(this, makeTable("silences", "Silences", ["Silenced", "Reason", "By", "Remaining", "Action"]));
    this.none = make("p.note", "No silences.");
    this.add = make("button", {onclick: () => page.actions.silence("*", "*", false)}, "New silence…");
    byId("silence-list").append(this.table, this.none, make("div.buttons", this.add));
  }

  update() {
    const {silences} = this.page.fleet.state;
    this.rows = new Map(silences.map((silence) => [silence.id, this.rows.get(silence.id) || new SilenceRow(this.page, silence)]));
    for (const silence of silences) this.rows.get(silence.id).silence = silence;
    setChildren(this.body, [...this.rows.values()].map((row) => row.element));
    this.tick();
    this.table.hidden = !silences.length;
    this.none.hidden = silences.length > 0;
    this.count.hidden = !silences.length;
    setText(this.count, `${silences.length}`);
  }

  tick() {
    for (const row of this.rows.values()) row.tick();
  }
}
