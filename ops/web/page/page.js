/* The web page: connects the monitor's events with the views. */
import {Actions, remember, remembered} from "./actions.js";
import {AlertPage} from "./alert.js";
import {AlertTable, AlertView} from "./alerts.js";
import {Connection, request} from "./connection.js";
import {byId, isolated, make, setAttribute, setChildren, setShape, setText} from "./elements.js";
import {Fleet} from "./fleet.js";
import {countText, durationText, timeText, withHint, zoneText} from "./format.js";
import {KINDS, worse} from "./levels.js";
import {RobotList} from "./robots.js";
import {SilenceList} from "./silences.js";

const VIEWS = ["robots", "alerts", "silences"];
const LOGGED_IN = "robot-health-logged-in";
const RECENT = 5;
const MOST_ANNOUNCED = 3;
const ANNOUNCE_MS = 2000;
const DAYS_MS = 60000;

/** Returns a part of an address as text, if it can be read. */
function decoded(part) {
  try {
    return decodeURIComponent(part);
  } catch (error) {
    return part;
  }
}

function drawIcon(link, svg) {
  const id = svg.firstElementChild.getAttribute("href"), {color} = getComputedStyle(svg);
  const content = document.querySelector(id).innerHTML.replaceAll("currentColor", color).replaceAll("var(--cut)", "#fff");
  const icon = `data:image/svg+xml,${encodeURIComponent(`<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16">${content}</svg>`)}`;
  if (link.href !== icon) link.href = icon;
}

class Page {
  constructor() {
    this.fleet = new Fleet();
    /** `connecting`, `live`, `lost` (there is an old state) or `login` (the token is required). */
    this.phase = "connecting";
    this.lostAt = performance.now();
    this.view = VIEWS[0];
    this.news = [];
    this.actions = new Actions((text) => this.announce(text));
    this.robots = new RobotList(this);
    this.silences = new SilenceList(this);
    this.alerts = new AlertView(this).table;
    this.alert = new AlertPage(this);
    this.recent = new AlertTable(this, {size: RECENT, pages: false});
    byId("recent-alerts").append(this.recent.element);
    this.connection = new Connection(this);
    addEventListener("hashchange", () => this.showView());
    byId("retry").addEventListener("click", () => this.connection.open());
    byId("login-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.login();
    });
    byId("logout").addEventListener("click", () => this.logout());
    setInterval(() => this.tick(), 1000);
    this.connection.open();
  }

  get isLive() { return this.phase === "live"; }

  get hasState() { return this.isLive || this.phase === "lost"; }

  state(state) {
    this.robots.update(this.fleet.replace(state), true);
    this.silences.update();
    this.setPhase("live");
    this.robots.follow();
    this.alert.show(this.alert.id);
    this.loadAlerts();
    this.loadDays();
  }

  async loadDays() {
    this.daysAt = performance.now() + DAYS_MS;
    const answer = await request("api/history/levels").catch(() => null);
    if (answer) this.robots.showDays(answer.robots);
  }

  change(change) {
    if (!this.isLive) return;  // its state has not come yet
    const changes = this.fleet.merge(change);
    this.robots.update(changes, false);
    this.silences.update();
    this.alerts.refresh();
    this.recent.refresh();
    if (changes.order || change.monitor) this.showSummary();
    if (!changes.alerts.length) return;
    this.collectNews(changes.alerts);
    this.loadAlerts();
  }

  loadAlerts() {
    byId("recent").hidden = false;
    if (this.view === "alerts") this.alerts.load();
    else if (this.view === "robots") this.recent.load();
  }

  samples(samples) {
    this.robots.addSamples(samples);
  }

  lost(reason) {
    this.reason = reason;
    if (this.isLive) this.lostAt = performance.now();
    this.setPhase(this.hasState ? "lost" : "connecting");
  }

  loginRequired() {
    this.setPhase("login");
    byId("token").focus();
  }

  setPhase(phase) {
    this.phase = phase;
    document.body.className = phase;
    byId("login").hidden = phase !== "login";
    byId("lost").hidden = phase !== "lost" && !(phase === "connecting" && this.connection.failures);
    byId("logout").hidden = !this.isLive || !remembered(LOGGED_IN);
    this.showView();
    this.showSummary();
    this.tick();
  }

  showSummary() {
    const {counts, robots} = this.fleet;
    const [name] = robots.size === 1 ? robots.keys() : [countText(robots.size, "robot")];
    const bad = [...counts].filter(([kind]) => kind !== "ok").map(([kind, count]) => `${robots.size > 1 ? `${count}\u00a0` : ""}${KINDS.get(kind)}`);
    const {monitorKind, faults} = this.fleet;
    if (monitorKind !== "ok") bad.push(`monitor ${KINDS.get(monitorKind)}`);
    const other = {connecting: "connecting…", lost: "no connection to the monitor", login: "token required"}[this.phase];
    const text = other || `${name}: ${bad.join(", ") || (robots.size ? "all OK" : "nothing to watch")}`;
    const kind = this.isLive && robots.size ? worse(counts.keys().next().value, monitorKind) : "unknown";
    setText(byId("summary"), text);
    setShape(byId("worst-shape"), kind);
    setAttribute(byId("worst-shape"), "class", `shape ${kind}`);
    document.title = `${text} – Robot health`;
    drawIcon(byId("icon"), byId("worst-shape"));
    byId("monitor-faults").hidden = !this.hasState || !faults.length;
    byId("monitor-faults").className = monitorKind;
    setChildren(byId("monitor-faults").firstChild, faults.map((fault) => make("p", isolated(fault))));
  }

  tick() {
    const {now} = this.fleet, text = byId("connection-text");
    if (!this.isLive) {
      setText(text, this.phase === "login" ? "not logged in" : "not connected");
      this.showLost();
      return;
    }
    setText(text, `live, ${timeText(now, now)} ${zoneText(now)}`);
    setText(byId("footer-text"), `robot_health_monitor ${this.fleet.state.version}. Times are local (${zoneText(now)}).`);
    this.robots.tick();
    this.silences.tick();
    if (performance.now() > this.daysAt) this.loadDays();
  }

  showLost() {
    const {retryAt} = this.connection, now = performance.now();
    const parts = [`for ${durationText((now - this.lostAt) / 1000)}.`];
    if (this.phase === "lost") parts.push(`The state below is from ${timeText(Date.parse(this.fleet.state.now), this.fleet.now)} and may be outdated.`);
    if (this.reason) parts.push(`The monitor answers: ${this.reason}.`);
    parts.push(retryAt ? `Next attempt in ${Math.max(0, Math.ceil((retryAt - now) / 1000))} s.` : "Connecting…");
    setText(byId("lost-text"), parts.join(" "));
  }

  /** Shows what the address names: #robots, #robots/NAME, #alerts, #alerts/ID, #silences. */
  showView() {
    const [view, name] = location.hash.slice(1).split("/").map(decoded);
    // Other addresses lead to an element of the view.
    if (VIEWS.includes(view)) this.view = view;
    byId("tabs").hidden = !this.hasState;
    for (const each of VIEWS) {
      byId(each).hidden = !this.hasState || each !== this.view;
      setAttribute(byId("tabs").querySelector(`[href="#${each}"]`), "aria-current", each === this.view ? "page" : null);
    }
    if (!this.hasState || location.hash === this.shown) return;
    this.shown = location.hash;
    this.loadAlerts();
    if (view === "robots" && name) this.robots.open(name);
    if (view !== "alerts") return;
    byId("all-alerts").hidden = !name;
    for (const id of ["alert-filter", "alert-history"]) byId(id).hidden = Boolean(name);
    this.alert.show(name || "");
  }

  /** Many alerts may come at once: they are read out together. */
  collectNews(alerts) {
    const known = alerts.filter(([robot, signal]) => !["waiting", "unknown"].includes(robot.kinds.get(signal)));
    if (known.length && !this.news.length) setTimeout(() => this.readNews(), ANNOUNCE_MS);
    this.news.push(...known.map(([{name, data, kinds}, signal]) => {
      const {message, hint} = data.signals[signal];
      return `${name}: ${signal} ${KINDS.get(kinds.get(signal))}, ${withHint(message, hint)}`;
    }));
  }

  readNews() {
    const more = this.news.length - MOST_ANNOUNCED;
    this.announce(this.news.slice(0, MOST_ANNOUNCED).join(". ") + (more > 0 ? `, and ${more} more` : ""));
    this.news = [];
  }

  announce(text) {
    byId("announcer").replaceChildren(text);
  }

  async login() {
    const field = byId("token"), problem = byId("login-error");
    setText(problem, "");
    try {
      await request("api/login", {token: field.value});
    } catch (error) {
      setText(problem, error.status === 401 ? "The token is wrong." : `Failed: ${error.message}`);
      field.select();
      return;
    }
    field.value = "";
    byId("main").focus();
    remember(LOGGED_IN, "yes");
    this.connection.open();
  }

  async logout() {
    await request("api/logout", {}).catch(() => undefined);
    remember(LOGGED_IN, "");
    this.connection.lose();
  }
}

new Page();
