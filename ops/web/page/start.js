/* Starts the page, or loads it again if one of its files has not come: the network may have changed meanwhile. */
const AGAIN_MS = 2000;

import("./page.js").then(() => HealthPlot).catch(() => setTimeout(() => location.reload(), AGAIN_MS));
