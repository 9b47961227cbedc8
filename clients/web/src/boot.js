// The picture of the person is painted first, then the fitting room is loaded: its script and its shaders take longer.
import { askEarly } from "./first.js";

async function painted() {
  const poster = document.getElementById("poster");
  if (location.search) poster.remove(); // it may be of others
  else await poster.decode().catch(() => {});
  if (document.visibilityState === "hidden") return; // is not painted
  await new Promise((resolve) => requestAnimationFrame(() => setTimeout(resolve)));
}

const picture = painted();
picture.then(() => import("./main.js"));
askEarly(picture).catch(() => {});
