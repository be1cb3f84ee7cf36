/* Numbers, durations and times as texts. Durations are in s, times in ms since 1970. */
import {setText} from "./elements.js";

/** Returns a duration as the monitor does: 312 s, 12 min 5 s, 25 h 1 min, from 100 h on 4 d 5 h. */
export function durationText(seconds) {
  if (!(seconds >= 0) || seconds > 1e12) return "";
  const units = seconds < 600 ? [1, "s"] : seconds < 3600 ? [60, "min", 1, "s"] : seconds < 360000 ? [3600, "h", 60, "min"] : [86400, "d", 3600, "h"];
  const [large, unit, small, smallUnit] = units, rest = small ? Math.floor((seconds % large) / small) : 0;
  return withUnits(`${Math.floor(seconds / large)} ${unit}${rest ? ` ${rest} ${smallUnit}` : ""}`);
}

/** Returns a text with °C, and without line breaks between numbers and units. */
export const withUnits = (text) => text.replace(/\bdegC\b/g, "°C").replace(/(\d) (?=[^\s\d(])/g, "$1\u00a0");

/** Returns a message with the hint why there are no samples. */
export const withHint = (text, hint) => withUnits(hint ? `${text} [${hint}]` : text);

/** Returns a value with at most five digits and its unit; texts as they are. */
export function valueText(value, unit) {
  if ((value ?? "") === "") return "";
  const text = typeof value === "number" ? Number(value.toPrecision(5)) : value;
  return withUnits(unit ? `${text} ${unit}` : String(text));
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
  return new Intl.DateTimeFormat("en", {timeZoneName: "short"}).formatToParts(time).find(({type}) => type === "timeZoneName").value;
}

/** Returns local time minus UTC, in s. */
export const utcOffset = (time) => -new Date(time).getTimezoneOffset() * 60;

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

export const countText = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;

/** Returns a pattern that matches a name: what patterns cannot have as such, except `kept`, becomes `?`. */
export const patternOf = (name, kept = "") => name.replace(/[*?]|(?! )[\p{C}\p{Z}]/gu, (character) => (kept.includes(character) ? character : "?"));
