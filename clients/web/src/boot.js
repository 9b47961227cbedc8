// The picture of the person is painted first, then the fitting room is loaded: its script and its shaders take longer.
import { askEarly } from "./first.js";

const LATEST_MS = 1500; // a page in the background is not painted

const poster = document.getElementById("poster");
if (location.search) poster.remove(); // it may be of others
const painted = new Promise((resolve) => {
  new PerformanceObserver((list) => {
    if (!poster.isConnected || list.getEntries().some(({ element }) => element === poster)) resolve();
  }).observe({ type: "largest-contentful-paint", buffered: true });
  setTimeout(resolve, LATEST_MS);
});
painted.then(() => import("./main.js"));
askEarly(painted).catch(() => {});
