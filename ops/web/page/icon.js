/* The icon of the tab: the shape of the worst level. */

/** Makes the icon `link` look like `svg`, which shows a shape. */
export function drawIcon(link, svg) {
  const id = svg.firstElementChild.getAttribute("href"), {color} = getComputedStyle(svg);
  const content = document.querySelector(id).innerHTML.replaceAll("currentColor", color).replaceAll("var(--cut)", "#fff");
  const icon = `data:image/svg+xml,${encodeURIComponent(`<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16">${content}</svg>`)}`;
  if (link.href !== icon) link.href = icon;
}
