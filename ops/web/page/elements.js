/* Building and changing elements. Texts become text nodes: nothing from a robot is ever parsed as HTML. */
export const SVG = "http://www.w3.org/2000/svg";

export const byId = (id) => document.getElementById(id);

/**
 * Returns a new element.
 * @param {string} tag - for example "button", or "button.primary" with a class.
 * @param {Object} attributes - `on…` are event listeners; null and false are left out.
 * @param {...(Node|string|null)} children - null is left out.
 */
export function make(tag, attributes = {}, ...children) {
  const [name, ...classes] = tag.split(".");
  const element = document.createElement(name);
  if (classes.length) element.className = classes.join(" ");
  if (name === "button") element.type = name;
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else setAttribute(element, key, value);
  }
  element.append(...children.filter((child) => child !== null));
  return element;
}

/** Returns an isolated text: its direction does not affect what surrounds it. */
export function isolated(text) {
  return make("bdi", {}, text);
}

/** Returns a table with these heads, and its empty body. The roles keep it a table where CSS lays it out otherwise. */
export function makeTable(kind, label, heads) {
  const body = make("tbody", {role: "rowgroup"});
  const table = make(`table.${kind}`, {role: "table", "aria-label": label},
    make("thead", {role: "rowgroup"}, makeRow("", ...heads.map((head) => make("th", {role: "columnheader", scope: "col"}, head)))), body);
  return {table, body};
}

/** Returns a row of a table. */
export function makeRow(kind, ...cells) {
  return make("tr", {role: "row", class: kind || null}, ...cells);
}

/** Returns a cell of a table; `span`: how many columns it takes. */
export function makeCell(kind, content, span = null) {
  return make("td", {role: "cell", class: kind || null, colspan: span}, content);
}

/** Returns one of the shapes that index.html defines, hidden from screen readers. */
export function shape(name) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("class", "shape");
  svg.setAttribute("viewBox", "0 0 16 16");
  svg.setAttribute("aria-hidden", "true");
  const use = document.createElementNS(SVG, "use");
  use.setAttribute("href", `#shape-${name}`);
  svg.append(use);
  return svg;
}

/** Makes `svg`, made by `shape`, show another shape. */
export function setShape(svg, name) {
  const use = svg.firstChild;
  if (use.getAttribute("href") !== `#shape-${name}`) use.setAttribute("href", `#shape-${name}`);
}

/** Sets a text only if it differs, so that an unchanged page costs nothing. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Sets an attribute only if it differs; null and false remove it. */
export function setAttribute(element, name, value) {
  if ((value ?? false) === false) element.removeAttribute(name);
  else if (element.getAttribute(name) !== String(value)) element.setAttribute(name, value === true ? "" : value);
}

/** Makes the children of `parent` those in `wanted`, in this order. Moves few and keeps the focus. */
export function setChildren(parent, wanted) {
  const keep = new Set(wanted);
  for (const child of [...parent.children]) if (!keep.has(child)) child.remove();
  const focused = document.activeElement;
  let next = parent.firstElementChild;
  for (const child of wanted) {
    if (child === next) next = next.nextElementSibling;
    else parent.insertBefore(child, next);
  }
  if (focused && focused !== document.activeElement && parent.contains(focused)) focused.focus({preventScroll: true});
}
