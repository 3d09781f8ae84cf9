// The decoded live monitor: what each frame means, and what is wrong, in the words of `canopen monitor`. The door sends what fits the
// choice, and a bounded part of that; here stand the last rows.

import { $, badge, counted, make, say, show } from "./dom.js";

const MOST_ROWS = 200;

/** The node-IDs of a text such as "3, 5-8"; null if it is none. */
export function nodesOf(text) {
  const nodes = new Set();
  for (const part of text.split(",").map((each) => each.trim()).filter(Boolean)) {
    const found = /^(\d{1,3})(?:\s*-\s*(\d{1,3}))?$/.exec(part);
    if (found === null) return null;
    const [first, last] = [Number(found[1]), Number(found[2] ?? found[1])];
    if (first < 1 || last > 127 || last < first) return null;
    for (let node = first; node <= last; node += 1) nodes.add(node);
  }
  return [...nodes];
}

export class Monitor {
  constructor(live) {
    this.live = live;
    this.isOn = false;
    this.known = "";
    this.mark = 0; // of the present choice
    this.rows = [];
    $("monitor-on").addEventListener("click", () => this.turn(!this.isOn));
    for (const id of ["monitor-net", "monitor-nodes", "monitor-service"]) $(id).addEventListener("change", () => this.begin());
    document.addEventListener("visibilitychange", () => this.send());
    $("trace-seconds").addEventListener("input", () => this.link());
    $("monitor-clear").addEventListener("click", () => { $("monitor-rows").replaceChildren(); });
    this.link();
  }

  update(nets) {
    const known = JSON.stringify(nets.map((net) => [net.net, net.name]));
    if (known === this.known) return;
    this.known = known;
    show($("monitor-net").parentElement, nets.length > 1);
    $("monitor-net").replaceChildren(...nets.map((net) => make("option", { value: net.net }, `${net.net} ${net.name}`)));
  }

  turn(on) {
    this.isOn = on;
    $("monitor-on").setAttribute("aria-pressed", String(on));
    say($("monitor-on"), on ? "Pause" : "Show frames");
    this.send();
  }

  begin() {
    const nodes = nodesOf($("monitor-nodes").value);
    $("monitor-nodes").setAttribute("aria-invalid", String(nodes === null));
    say($("monitor-wrong"), nodes === null ? "Nodes are numbers from 1 to 127: 3, 5-8" : "");
    if (nodes === null) return;
    $("monitor-rows").replaceChildren();
    this.send();
  }

  /** Say what is to be seen, after a new connection, too. A page that is hidden looks at nothing. */
  send() {
    if (!this.isOn || document.hidden) {
      this.live.send("monitor", { on: false });
      return;
    }
    const service = $("monitor-service").value;
    this.mark += 1;
    this.live.send("monitor", { mark: this.mark, net: Number($("monitor-net").value || 1), nodes: nodesOf($("monitor-nodes").value) ?? [], services: service ? [service] : [] });
  }

  frames(message) {
    if (!this.isOn || message.mark !== this.mark) return; // of the choice before, perhaps of another net
    const rows = message.rows.map(([kind, seconds, frame, service, node, text]) => {
      const mark = kind === "finding" ? "!" : kind === "sum" ? "=" : "";
      const what = kind === "finding" ? badge("finding") : make("span", {}, service);
      return make("tr", { class: kind }, make("td", { class: "number" }, seconds.toFixed(3)), make("td", { class: "place" }, mark ? make("span", { title: kind }, mark) : frame),
        make("td", {}, what), make("td", { class: "number" }, node || ""), make("td", { class: "said" }, text));
    });
    const body = $("monitor-rows");
    body.prepend(...rows.reverse());
    while (body.children.length > MOST_ROWS) body.lastElementChild.remove();
    say($("monitor-counts"), `${counted(message.seen, "frame")} seen, ${message.fitting} of the choice, ${message.left_out} of these not shown${message.lost ? `; ${message.lost} lost` : ""}`);
    $("monitor-counts").classList.toggle("warned", message.lost > 0);
  }

  link() {
    const seconds = Math.max(1, Number($("trace-seconds").value) || 60);
    $("trace").href = `/api/v1/trace?seconds=${seconds}`;
  }
}
