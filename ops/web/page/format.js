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

/** Returns a text with °C in place of the unit degC. */
export function withDegrees(text) {
  return text.replace(/\bdegC\b/g, "°C");
}

/** Returns a message or alert line with the hint why there are no samples, as everything shows it. */
export function withHint(text, hint) {
  return withDegrees(hint ? `${text} [${hint}]` : text);
}

/** Returns a value with its unit, with at most five digits; texts as they are. */
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

/** Returns the local date and time with its zone. */
export function fullTimeText(time) {
  const text = local(time);
  return text ? `${text} ${zoneText(time)}` : "";
}

/** Returns the name of the local time zone, for example CET. */
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

/** Shows in a time element how long ago `since` is, and with the pointer on it when that was. */
export function showAge(element, since, now) {
  const known = Number.isFinite(since);
  setText(element, known ? durationText(Math.max(0, now - since) / 1000) : "");
  if (known && element.since !== since) element.title = `since ${fullTimeText(element.since = since)}`;
}

/** Returns "1 alert", "2 alerts". */
export function countText(count, noun) {
  return `${count} ${noun}${count === 1 ? "" : "s"}`;
}

/**
 * Returns a pattern that matches a name: characters that patterns cannot have as such become `?`, which matches any;
 * those in `kept` stay.
 */
export function patternOf(name, kept = "") {
  return name.replace(/[*?[\]"]|(?! )[\p{C}\p{Z}]/gu, (character) => (kept.includes(character) ? character : "?"));
}
