// What the page says: one line for what goes on, in words.
export const element = (id) => document.getElementById(id);

let spokenBy = "user";

// by: who speaks; the stream clears only what it has said itself.
export function say(sentence, { bad = false, by = "user" } = {}) {
  spokenBy = by;
  element("message").textContent = sentence;
  element("message").classList.toggle("bad", bad);
}

export function hush(by) {
  if (spokenBy === by) say("", { by });
}

// refusal: why there is no service, or null where there is one.
export function tellOffline(refusal) {
  element("offline").hidden = refusal === null;
  if (refusal) element("offline-words").textContent = refusal.message;
}

// A task whose failure is told.
export const failing = (task) => async (...values) => {
  try {
    return await task(...values);
  } catch (error) {
    say(error.message, { bad: true });
    return undefined;
  }
};

// An element with properties, attributes ("aria-" and "data-" names, role) and children.
export function make(tag, { children = [], ...properties } = {}) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (/^(aria-|data-|role$|for$)/.test(name)) made.setAttribute(name, value);
    else made[name] = value;
  }
  made.append(...children);
  return made;
}

// "top", "top and skirt", "top, skirt and coat".
export const listed = (names) => [names.slice(0, -1).join(", "), ...names.slice(-1)].filter(Boolean).join(" and ");

export const title = (name) => {
  const words = name.replaceAll("_", " ").trim();
  return words === "tshirt" ? "T-shirt" : words.charAt(0).toUpperCase() + words.slice(1);
};
