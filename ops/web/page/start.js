/* Starts the page, behind plot.js, or loads it again if a file has not come. */
const AGAIN_MS = 2000;

import("./page.js").then(() => HealthPlot).catch((error) => {
  console.error(error);
  setTimeout(() => location.reload(), AGAIN_MS);
});
