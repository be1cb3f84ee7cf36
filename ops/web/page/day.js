/* The bar of a robot's last 24 hours: one cell per 15 minutes, as /api/history/levels has them. */
import {addSvg, setAttribute} from "./elements.js";
import {KINDS, rankOf} from "./levels.js";

const LETTERS = {O: "ok", W: "warn", E: "error", S: "stale"};
/** Levels differ in height, not in colour alone. */
const HEIGHT = {ok: 4, warn: 8, stale: 10, error: 12};
const FULL = 12;

export function makeDay() {
  const svg = addSvg(null, "svg", {class: "day", role: "img", preserveAspectRatio: "none"});
  showDay(svg, "");
  return svg;
}

/** Shows cells, one letter each; `-`: nothing was known. */
export function showDay(svg, cells) {
  if (svg.cells === cells) return;
  svg.cells = cells;
  svg.setAttribute("viewBox", `0 0 ${cells.length || 1} ${FULL}`);
  svg.replaceChildren();
  let x = 0;
  for (const [run] of cells.matchAll(/(.)\1*/g)) {
    const kind = LETTERS[run[0]] || "unknown", height = HEIGHT[kind] || FULL;
    addSvg(svg, "rect", {class: `cell ${kind}`, x, width: run.length, y: FULL - height, height});
    x += run.length;
  }
  const hours = (letter) => `${[...cells].filter((each) => each === letter).length / 4} h`;
  const parts = Object.keys(LETTERS).filter((letter) => cells.includes(letter)).map((letter) => [letter, LETTERS[letter]])
    .sort(([, one], [, other]) => rankOf(one) - rankOf(other)).map(([letter, kind]) => `${KINDS.get(kind)} ${hours(letter)}`);
  if (cells.includes("-")) parts.push(`unknown ${hours("-")}`);
  setAttribute(svg, "aria-label", `last 24 hours: ${parts.join(", ") || "unknown"}`);
}
