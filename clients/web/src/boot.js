// The picture of the person is painted first, then the fitting room is loaded: its script and its shaders take longer.
import { askEarly } from "./first.js";

const LATEST_MS = 1500; // a page in the background is not painted

let begun = false;
function begin() {
  if (begun) return;
  begun = true;
  import("./main.js");
}

const poster = document.getElementById("poster");
if (location.search) poster.remove(); // it may be of others
askEarly().catch(() => {});
new PerformanceObserver((list) => {
  if (!poster.isConnected || list.getEntries().some(({ element }) => element === poster)) begin();
}).observe({ type: "largest-contentful-paint", buffered: true });
setTimeout(begin, LATEST_MS);
