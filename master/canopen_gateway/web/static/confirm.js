// A question before what cannot be taken back. A dialogue of the page, not of the browser: that one would stop all timers, and with
// them the signs of life by which a machine is held.

import { make } from "./dom.js";

/** Ask, and return whether the answer was yes. Escape, and a click beside it, are no. */
export function confirmed(question, detail, yes) {
  return new Promise((done) => {
    const no = make("button", { type: "button" }, "Cancel");
    const go = make("button", { type: "button", class: "warning" }, yes);
    const title = make("h2", { id: "confirm-title" }, question);
    const dialog = make("dialog", { "aria-labelledby": "confirm-title" }, title, make("p", {}, detail), make("div", { class: "row" }, no, go));
    const end = (answer) => {
      dialog.close();
      dialog.remove();
      done(answer);
    };
    no.addEventListener("click", () => end(false));
    go.addEventListener("click", () => end(true));
    dialog.addEventListener("cancel", (event) => { event.preventDefault(); end(false); });
    document.body.append(dialog);
    dialog.showModal();
    no.focus();
  });
}
