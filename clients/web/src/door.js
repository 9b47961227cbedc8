// The door: a service with keys says nothing to who has none.
import { setKey } from "./service.js";
import { element } from "./words.js";

// Asks for a key where error is about one, and throws it.
export function askForKey(error) {
  if (error.status === 401) {
    document.body.dataset.state = "locked";
    element("door").hidden = false;
    element("key").focus();
  }
  throw error;
}

element("door").addEventListener("submit", (event) => {
  event.preventDefault();
  setKey(element("key").value.trim());
  location.reload();
});
