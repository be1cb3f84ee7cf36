/* What a signal or robot is shown as: its level, or why the level is unknown. */
import {make, setShape, setText, shape} from "./elements.js";

/** The labels, worst first. */
export const KINDS = new Map(Object.entries(
  {error: "ERROR", nolink: "NO LINK", stale: "STALE", warn: "WARN", unknown: "unreachable", waiting: "waiting", ok: "OK"},
));

const RANK = [...KINDS.keys()];
export const LINK = "link";

export function kindOfLevel(level) {
  const kind = level.toLowerCase();
  return KINDS.has(kind) ? kind : "unknown";
}

export function kindOfSignal(name, signal) {
  if (signal.state === "waiting") return "waiting";
  if (signal.state === "unreachable") return "unknown";
  const kind = kindOfLevel(signal.level);
  return name === LINK && kind !== "ok" ? "nolink" : kind;
}

/** Returns a number that is lower for a worse kind. */
export const rankOf = (kind) => RANK.indexOf(kind);

/** Whether a kind is an alert: known, and not OK. */
export const isAlert = (kind) => rankOf(kind) < rankOf("unknown");

export const worse = (kind, other) => rankOf(other) < rankOf(kind) ? other : kind;

export class Badge {
  constructor(kind) {
    this.shape = shape(kind);
    this.text = make("span.badge-text");
    this.element = make("span", this.shape, this.text);
    this.show(kind);
  }

  show(kind) {
    if (kind === this.kind) return;
    this.kind = kind;
    this.element.className = `badge ${kind}`;
    setShape(this.shape, kind);
    setText(this.text, KINDS.get(kind));
  }
}
