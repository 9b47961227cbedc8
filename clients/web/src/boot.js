// The page is painted first, then the fitting room is loaded: its script and its shaders take longer than a picture.
const LATEST_MS = 1500; // a page in the background is not painted

let begun = false;
function begin() {
  if (begun) return;
  begun = true;
  import("./main.js");
}

new PerformanceObserver(begin).observe({ type: "paint", buffered: true });
setTimeout(begin, LATEST_MS);
