/* The connection to the monitor: events, requests, and what happens when it is lost. */
const SILENCE_MS = 5000;
const FIRST_DELAY_MS = 1000;
const LONGEST_DELAY_MS = 30000;
const REQUEST_MS = 10000;

/** Returns the answer to a GET, or with `body` to a POST; throws an Error with `status` and a message for users. */
export async function request(path, body) {
  const options = {credentials: "same-origin", cache: "no-store", signal: AbortSignal.timeout(REQUEST_MS)};
  if (body !== undefined) {
    Object.assign(options, {method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify(body)});
  }
  let response;
  try {
    response = await fetch(path, options);
  } catch (error) {
    throw new Error("no answer from the monitor");
  }
  const answer = await response.json().catch(() => ({}));
  if (response.ok) return answer;
  const problem = answer.error || `${response.status} ${response.statusText}`;
  const wait = response.headers.get("Retry-After");
  throw Object.assign(new Error(wait ? `${problem}; try again in ${wait} s` : problem), {status: response.status});
}

/** A stream of events, opened again with growing delays. */
export class Connection {
  /** `listener` has `state(data)`, `change(data)`, `samples(data)`, `lost(reason)` and `loginRequired()`. */
  constructor(listener) {
    this.listener = listener;
    this.failures = 0;
    this.robots = [];
    /** Time of the next attempt; 0: none is planned. */
    this.retryAt = 0;
    addEventListener("online", () => this.retryAt && this.open());
    document.addEventListener("visibilitychange", () => !document.hidden && this.retryAt && this.open());
    // A page that is kept for going back would hold one of six connections.
    addEventListener("pagehide", () => this.close());
    addEventListener("pageshow", ({persisted}) => persisted && this.open());
  }

  open() {
    this.close();
    const source = this.source = new EventSource(`api/events?${new URLSearchParams(this.robots.map((name) => ["robot", name]))}`);
    for (const type of ["state", "change", "samples"]) source.addEventListener(type, (event) => this.receive(event));
    source.addEventListener("error", () => this.lose());
    this.watch();
  }

  follow(robots) {
    if (robots.every((name) => this.robots.includes(name))) return;
    this.robots = robots;
    this.open();
  }

  /** Ends the connection; nothing is tried again. */
  close() {
    clearTimeout(this.watchdog);
    clearTimeout(this.retryTimer);
    this.retryAt = 0;
    if (this.source) this.source.close();
    this.source = null;
  }

  receive({type, data}) {
    this.failures = 0;
    this.watch();
    this.listener[type](JSON.parse(data));
  }

  /** An event comes each second: a silent connection is lost. */
  watch() {
    clearTimeout(this.watchdog);
    this.watchdog = setTimeout(() => this.lose(), SILENCE_MS);
  }

  /** Plans the next attempt, and finds out why this one failed. */
  async lose() {
    this.close();
    this.robots = [];  // they may be why: a robot that is gone
    const delay = Math.min(LONGEST_DELAY_MS, FIRST_DELAY_MS * 2 ** this.failures++) * (0.8 + 0.4 * Math.random());
    this.retryAt = performance.now() + delay;
    this.retryTimer = setTimeout(() => this.open(), delay);
    const attempt = this.retryTimer;
    this.listener.lost("");
    try {
      await request("api/state?window=0&robot=");
    } catch (error) {
      if (this.retryTimer !== attempt || !this.retryAt) return;
      if ([401, 429].includes(error.status)) {  // 429: too many wrong tokens; the right one is accepted
        this.close();
        this.listener.loginRequired();
      } else if (error.status && error.status !== 404) {
        this.listener.lost(error.message);
      }
    }
  }
}
