/* Elements. Texts become text nodes: nothing from a robot is ever parsed as HTML. */
export const addSvg = HealthPlot.add;

export const byId = (id) => document.getElementById(id);

/** Returns a new element. `tag` may have a class, as "button.primary"; then attributes, of which `on…` are listeners, and children or null. */
export function make(tag, ...children) {
  const attributes = children[0]?.constructor === Object ? children.shift() : {};
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

export const isolated = (text) => make("bdi", text);

/** Returns a table and its body. The roles keep it a table whatever CSS does. */
export function makeTable(kind, label, heads) {
  const body = make("tbody", {role: "rowgroup"});
  const table = make(`table.${kind}`, {role: "table", "aria-label": label},
    make("thead", {role: "rowgroup"}, makeRow("", ...heads.map((head) => make("th", {role: "columnheader", scope: "col"}, head)))), body);
  return {table, body};
}

export const makeRow = (kind, ...cells) => make("tr", {role: "row", class: kind || null}, ...cells);

/** Returns a cell of a table; `span`: how many columns it takes. */
export const makeCell = (kind, content, span = null) => make("td", {role: "cell", class: kind || null, colspan: span}, content);

export function shape(name) {
  const svg = addSvg(null, "svg", {class: "shape", viewBox: "0 0 16 16", "aria-hidden": true});
  addSvg(svg, "use", {href: `#shape-${name}`});
  return svg;
}

export const silencedMark = () => make("span.silenced-mark", {hidden: true}, shape("silenced"), make("span", "silenced"));

export function setShape(svg, name) {
  setAttribute(svg.firstChild, "href", `#shape-${name}`);
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

/** Makes `wanted` the children of `parent`; moves few and keeps the focus. */
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
