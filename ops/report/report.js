/* Draws the plots of a report, and links its alerts with them. */
"use strict";

(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const view = new HealthPlot.View(data.from, data.to, data.utcOffset);
  const plots = new Map();
  for (const signal of data.signals) {
    const element = document.getElementById(signal.id);
    if (element) plots.set(signal.id, new HealthPlot.Plot(element.querySelector(".plot"), signal, view));
  }

  // Effects are folded below their cause.
  for (const row of document.querySelectorAll("tr[data-effects]")) {
    const number = Number(row.dataset.effects), effects = [];
    for (let next = row; effects.length < number; effects.push(next)) next = next.nextElementSibling;
    const button = document.createElement("button");
    button.textContent = `+ ${number} affected`;
    const fold = (isOpen) => {
      button.setAttribute("aria-expanded", isOpen);
      for (const effect of effects) effect.hidden = !isOpen;
    };
    button.addEventListener("click", () => fold(effects[0].hidden));
    fold(false);
    row.cells[0].append(" ", button);
  }

  function pick(alertId) {
    for (const plot of plots.values()) plot.pick(alertId);
  }

  // From an alert in the table to its plot: the link itself scrolls there.
  document.getElementById("alerts").addEventListener("click", (event) => {
    const link = event.target.closest("a[data-at]");
    if (!link) return;
    const at = Number(link.dataset.at), span = Math.min(view.to - view.from, (view.last - view.first) / 4);
    if (at < view.from || at > view.to) view.show(at - span / 2, at + span / 2);
    pick(link.dataset.alert);
  });

  // From a marker in a plot to its row in the table.
  window.addEventListener("hashchange", () => {
    const id = decodeURIComponent(location.hash.slice(1));
    if (document.getElementById(id) instanceof HTMLTableRowElement) pick(id);
  });
})();
