/* Numbers, durations and times as texts. Durations are in s, times in ms since 1970. */
import {setText} from "./elements.js";

/** Returns a duration in at most two units: 95 s, 12 min, 5 h 12 min, 4 d 5 h. */
export function durationText(seconds) {
  if (!(seconds >= 0) || seconds > 1e12) return "";
  if (seconds < 120) return `${Math.floor(seconds)} s`;
  const minutes = Math.floor(seconds / 60);
  if (minutes < 60) return `${minutes} min`;
  const hours = Math.floor(minutes / 60);
  const [large, unit, small, smallUnit] = hours < 48 ? [hours, "h", minutes % 60, "min"] : [Math.floor(hours / 24), "d", hours % 24, "h"];
  return `${large} ${unit}${small ? ` ${small} ${smallUnit}` : ""}`;
}

export function withDegrees(text) {
  return text.replace(/\bdegC\b/g, "°C");
}

/** Returns a message with the hint why there are no samples. */
export function withHint(text, hint) {
  return withDegrees(hint ? `${text} [${hint}]` : text);
}

/** Returns a value with at most five digits and its unit; texts as they are. */
export function valueText(value, unit) {
  if ((value ?? "") === "") return "";
  const text = typeof value === "number" ? Number(value.toPrecision(5)) : value;
  return withDegrees(unit ? `${text} ${unit}` : String(text));
}

/** Returns the local time of day, with the date unless it is the day of `now`. */
export function timeText(time, now) {
  const text = local(time);
  return text.slice(0, 10) === local(now).slice(0, 10) ? text.slice(11) : text;
}

export function fullTimeText(time) {
  const text = local(time);
  return text ? `${text} ${zoneText(time)}` : "";
}

export function zoneText(time) {
  const parts = new Intl.DateTimeFormat("en", {timeZoneName: "short"}).formatToParts(new Date(time));
  return parts.find((part) => part.type === "timeZoneName").value;
}

/** Returns local time minus UTC, in s. */
export function utcOffset(time) {
  return -new Date(time).getTimezoneOffset() * 60;
}

function local(time) {
  const shifted = new Date(time + utcOffset(time) * 1000);
  return Number.isNaN(shifted.getTime()) ? "" : shifted.toISOString().slice(0, 19).replace("T", " ");
}

/** Shows how long ago `since` is; its time appears under the pointer. */
export function showAge(element, since, now) {
  const known = Number.isFinite(since);
  setText(element, known ? durationText(Math.max(0, now - since) / 1000) : "");
  if (known && element.since !== since) element.title = `since ${fullTimeText(element.since = since)}`;
}

export function countText(count, noun) {
  return `${count} ${noun}${count === 1 ? "" : "s"}`;
}

/** Returns a pattern that matches a name: what patterns cannot have as such, except `kept`, becomes `?`. */
export function patternOf(name, kept = "") {
  return name.replace(/[*?[\]"]|(?! )[\p{C}\p{Z}]/gu, (character) => (kept.includes(character) ? character : "?"));
}
