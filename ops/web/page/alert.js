/* The page of one alert, `#alerts/ID`: what was seen, wrong and in force then, and notes. */
import {remember, remembered, AUTHOR} from "./actions.js";
import {request} from "./connection.js";
import {byId, isolated, make, setText} from "./elements.js";
import {fullTimeText, utcOffset, withUnits, withHint} from "./format.js";
import {Badge, kindOfLevel} from "./levels.js";
import {drawEvidence} from "./plots.js";
import {requestSamples, stored} from "./ranges.js";

const AROUND_S = 1800;
const PERIOD_S = 10;

const list = (items) => (items.length ? make("ul", ...items.map((item) => make("li", ...item))) : null);
const link = (href, text) => make("a", {href}, isolated(text));
const part = (heading, content) => content && make("section", make("h3", heading), content);

export class AlertPage {
  constructor(page) {
    this.page = page;
    this.box = byId("alert-page");
    this.id = "";
  }

  async show(id) {
    if (id === this.id && !this.hasFailed) return;
    this.id = id;
    this.hasFailed = false;
    this.box.replaceChildren();
    if (!id) return;
    try {
      if (!/^\d+$/.test(id)) throw new Error("its address does not end with a number");
      const past = await request(`api/history/${id}`);
      if (id === this.id) this.fill(past);
    } catch (error) {
      if (id !== this.id) return;
      this.hasFailed = true;
      this.box.replaceChildren(make("p.error-text", {role: "alert"}, `The alert cannot be shown: ${error.message}`));
    }
  }

  fill(past) {
    const {alert, others, silences, thresholds, thresholds: {what_to_do: advice}} = past, time = Date.parse(alert.time);
    this.notes = make("ul.notes");
    const settings = Object.entries(thresholds).map(([key, value]) => `${key}: ${JSON.stringify(value)}`).join("\n");
    const file = alert.black_box && link(`api/black_box/${encodeURIComponent(alert.black_box)}`, alert.black_box);
    if (file) file.download = alert.black_box;
    const robot = this.page.fleet.robots.get(alert.robot), address = `#robots/${encodeURIComponent(alert.robot)}`;
    const cause = alert.cause || robot?.data.signals[alert.signal]?.cause, by = others.find(({signal}) => signal === cause);
    const window = make("div.plot"), around = make("div.plot");
    this.box.append(...[
      make("h3.alert-title", new Badge(kindOfLevel(alert.to_level)).element, " ", isolated(withHint(alert.text, alert.hint))),
      make("p.facts", `${fullTimeText(time)} · `, link(address, alert.robot)),
      part("Cause", cause && make("p", link(by ? `#alerts/${by.id}` : address, cause))),
      part("Affects", list(alert.effects.map((name) => [link(address, name)]))),
      part("What to do", advice && make("p", /^https?:/.test(advice) ? link(advice, advice) : isolated(advice))),
      part("Samples in the window", window), part("Half an hour before and after", around),
      part("Also not OK then", list(others.map((other) => [new Badge(kindOfLevel(other.to_level)).element, " ", link(`#alerts/${other.id}`, withHint(other.text, other.hint))]))),
      part("Thresholds in force", settings ? make("pre", settings) : null),
      part("Silences", list(silences.map((silence) => [isolated(`${silence.matchers}: ${silence.reason}${silence.author && ` (${silence.author})`}`)]))),
      part("Black box", file ? make("p", file) : null),
      make("section", make("h3", "Notes"), this.notes, this.form(alert)),
    ].filter((each) => each));
    if (past.samples.some(([, value]) => value !== null)) drawEvidence(window, past);
    else window.append("No samples.");
    alert.notes.forEach((note) => this.addNote(note));
    this.drawAround(around, past, time / 1000);
  }

  /** Draws what was stored of the half hours before and after the alert at `t`, or says why there is nothing. */
  async drawAround(box, {alert, unit, bounds}, t) {
    let samples = [], problem = "The history has no samples of this time.";
    try {
      samples = await requestSamples(alert.robot, alert.signal, PERIOD_S, t - AROUND_S, t + AROUND_S);
    } catch (error) {
      problem = `The history cannot be read: ${error.message}`;
    }
    if (samples.every(({min}) => min === null)) {
      box.append(problem);
      return;
    }
    const {data, levels} = stored(samples, [null, 2 * AROUND_S, PERIOD_S], t + AROUND_S);
    const alerts = [{id: "alert-page", t, level: alert.to_level, text: alert.text}];
    const view = new HealthPlot.View(t - AROUND_S, t + AROUND_S, utcOffset(t * 1000));
    const name = `${alert.signal}, half an hour before and after`;
    new HealthPlot.Plot(box, {name, unit: withUnits(unit || ""), bounds, ...data, levels, alerts, until: levels.at(-1)[0]}, view);
  }

  form(alert) {
    const text = make("input", {maxlength: 1000, required: "", "aria-label": "Note", placeholder: "What happened, what was done"});
    const author = make("input", {maxlength: 200, "aria-label": "Your name", placeholder: "Your name", autocomplete: "name"});
    const problem = make("p.error-text", {role: "alert"}), button = make("button", "Add note");
    button.type = "submit";
    author.value = remembered(AUTHOR);
    const form = make("form.note-form", text, author, button, problem);
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      setText(problem, "");
      button.disabled = true;
      remember(AUTHOR, author.value.trim());
      try {
        const {note} = await request("api/note", {id: alert.id, text: text.value, author: author.value.trim()});
        this.addNote(note);
        text.value = "";
      } catch (error) {
        setText(problem, `Failed: ${error.message}`);
      }
      button.disabled = false;
    });
    return form;
  }

  addNote({time, author, text}) {
    this.notes.append(make("li", isolated(text), make("span.hint", ` ${author ? `${author}, ` : ""}${fullTimeText(Date.parse(time))}`)));
  }
}
