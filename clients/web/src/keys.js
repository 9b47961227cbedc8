// Keys of the page, the help that lists them, the drawers.
import { element } from "./words.js";

const TYPED = "input:not([type=range]):not([type=radio]):not([type=checkbox]), select, textarea";
const TABS = ["wear", "fabric", "body"];

// actions: by key, lower case.
export function listen(actions) {
  addEventListener("keydown", (event) => {
    const { target, key, ctrlKey, metaKey, altKey } = event;
    if (ctrlKey || metaKey || altKey || target.closest("dialog, form")) return;
    if (target.closest(TYPED)) return;
    if (key === " " && target.closest("button, a, input, [tabindex='0']:not(canvas)")) return; // it has its own meaning there
    const action = actions[key.toLowerCase()];
    if (!action) return;
    event.preventDefault();
    action();
  });
}

export function turnByKeys(canvas, stage) {
  const turns = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  canvas.addEventListener("keydown", (event) => {
    const turn = turns[event.key];
    if (turn) stage.turn(...turn);
    else if (event.key === "+" || event.key === "=") stage.come(1);
    else if (event.key === "-") stage.come(-1);
    else return;
    event.preventDefault();
  });
}

export function makeDrawers() {
  const tabs = TABS.map((name) => element(`tab-${name}`));
  const open = (chosen) => {
    tabs.forEach((tab) => {
      tab.setAttribute("aria-selected", tab === chosen);
      tab.tabIndex = tab === chosen ? 0 : -1;
      element(tab.getAttribute("aria-controls")).hidden = tab !== chosen;
    });
  };
  tabs.forEach((tab, i) => {
    tab.addEventListener("click", () => open(tab));
    tab.addEventListener("keydown", ({ key }) => {
      const to = { ArrowRight: i + 1, ArrowLeft: i - 1, Home: 0, End: tabs.length - 1 }[key];
      if (to === undefined) return;
      const next = tabs.at(to % tabs.length);
      open(next);
      next.focus();
    });
  });
}

export function makeSheet() {
  element("sheet").addEventListener("click", () => {
    const up = document.body.dataset.sheet === "down";
    document.body.dataset.sheet = up ? "up" : "down";
    element("sheet").setAttribute("aria-expanded", up);
  });
}

export function makeHelp() {
  element("help-open").addEventListener("click", () => element("help").showModal());
}
