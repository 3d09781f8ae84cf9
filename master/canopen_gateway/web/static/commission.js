// Commissioning of a drive: the dialogue of `canopen drive commission`, shown step by step. It goes on while this page holds the
// machine; whatever lets go, ends it, and the drive is halted.

import { $, make, number, say, show } from "./dom.js";

export class Commissioning {
  constructor(live, jog) {
    this.live = live;
    this.jog = jog; // holds the machine, and numbers the messages
    this.isOn = false;
    this.place = null; // [net, node]
    this.question = 0;
    $("commission-begin").addEventListener("click", () => this.begin());
    $("commission-end").addEventListener("click", () => this.jog.giveUp());
  }

  /** The drive that is shown, and whether it may be moved. */
  offer(place, mayMove) {
    if (!this.isOn) this.place = place;
    show($("commission"), this.isOn || place !== null);
    const why = mayMove ? "" : "Commissioning moves the drive, and that is not allowed here: this gateway was started without --allow motion.";
    say($("commission-why"), why);
    show($("commission-why"), why !== "");
    $("commission-begin").disabled = !mayMove || this.isOn || place === null;
    if (place !== null && !this.isOn) say($("commission-begin"), `Commission node ${place[1]} …`);
  }

  begin() {
    this.isOn = true;
    this.question = 0;
    $("commission-said").replaceChildren();
    $("commission-question").replaceChildren();
    show($("commission-box"), true);
    this.jog.holdMachine();
    this.live.send("commission", { n: this.jog.next(), net: this.place[0], node: this.place[1] });
    this.offer(this.place, true);
  }

  /** It was refused, or the connection is gone. */
  lost(text) {
    if (!this.isOn) return;
    this.add(make("p", { class: "bad-text" }, text));
    this.finish();
  }

  finish() {
    this.isOn = false;
    $("commission-question").replaceChildren();
    show($("commission-end"), false);
  }

  add(element) {
    $("commission-said").append(element);
    $("commission-said").scrollTop = $("commission-said").scrollHeight;
  }

  said(message) {
    switch (message.what) {
      case "heading": this.add(make("h3", { class: "net" }, message.text)); break;
      case "fact": this.add(make("p", { class: "fact" }, make("span", { class: "quiet" }, message.name), make("span", {}, message.text))); break;
      case "say": this.add(make("p", {}, message.text)); break;
      case "remark": this.add(make("p", { class: "quiet" }, message.text)); break;
      case "warn": this.add(make("p", { class: "warned" }, message.text)); break;
      case "file": this.add(this.file(message)); break;
      case "ask": if (message.question > this.question) this.ask(message); break;
      case "end":
        this.add(make("p", { class: message.confirmed ? "" : "warned" }, message.text));
        this.finish();
        this.jog.giveUp();
        break;
      default:
    }
    show($("commission-end"), this.isOn);
  }

  file(message) {
    const bytes = Uint8Array.from(atob(message.data), (letter) => letter.charCodeAt(0));
    const link = make("a", { class: "button", href: URL.createObjectURL(new Blob([bytes], { type: "application/octet-stream" })), download: message.name }, `Keep ${message.name}`);
    return make("p", {}, link);
  }

  /** Show a question, with what may be answered. An empty answer is its default, which is safe. */
  ask(message) {
    this.question = message.question;
    const answer = (value, shown) => {
      $("commission-question").replaceChildren();
      this.add(make("p", { class: "quiet" }, `${message.text} ${shown}`));
      this.live.send("answer", { n: this.jog.next(), question: message.question, value });
    };
    const form = make("form", { class: "row" });
    const label = make("label", { htmlFor: "commission-answer" }, message.text);
    if (message.kind === "may") {
      const no = make("button", { type: "button" }, "No");
      const yes = make("button", { type: "button", class: "warning" }, "Yes");
      no.addEventListener("click", () => answer(false, "no"));
      yes.addEventListener("click", () => answer(true, "yes"));
      form.setAttribute("role", "group");
      form.setAttribute("aria-label", message.text);
      form.append(make("strong", {}, message.text), no, yes);
    } else if (message.kind === "choice") {
      const select = make("select", { id: "commission-answer" }, ...message.choices.map((each) => make("option", { value: each, selected: each === message.default }, each)));
      form.append(label, select, make("button", { type: "submit" }, "Next"));
      form.addEventListener("submit", () => answer(select.value, select.value));
    } else {
      const standard = message.default === null ? "none" : `${number(message.default, 6)} ${message.unit}`.trim();
      const input = make("input", { id: "commission-answer", class: "nodes", inputMode: "decimal", autocomplete: "off", placeholder: standard });
      form.append(label, input, make("button", { type: "submit" }, "Next"));
      form.addEventListener("submit", () => {
        const text = input.value.trim();
        answer(text === "" ? null : Number.isFinite(Number(text)) ? Number(text) : text, text === "" ? standard : text);
      });
    }
    form.addEventListener("submit", (event) => event.preventDefault());
    $("commission-question").replaceChildren(form);
    (form.querySelector("input, select") ?? form.querySelector("button")).focus();
  }
}
