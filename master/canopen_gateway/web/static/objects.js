// The object browser: search, read, write, watch. The list of a node is loaded once, and filtered here.

import { $, breakable, isOfFleet, make, nodeText, say } from "./dom.js";
import { ask } from "./link.js";
import { bodyOf, shown } from "./whole.js";

const SHOWN = 60; // rows at a time

export class ObjectBrowser {
  constructor(notice, watch) {
    this.notice = notice;
    this.watch = watch; // called with { net, node, path, name }
    this.allow = [];
    this.nets = [];
    this.place = null; // [net, node]
    this.objects = [];
    this.known = "";
    this.loading = new AbortController();
    $("search").addEventListener("input", () => this.draw());
    $("object-node").addEventListener("change", () => this.choose(...$("object-node").value.split("/").map(Number)));
  }

  /** Whether anything may be written to the node that is chosen: over a fleet its bridge has to allow it, too. */
  get mayWrite() { return (this.nets.find((net) => net.net === this.place?.[0])?.allow ?? this.allow).length > 0; }

  /** The nodes that there are, for the choice; and what is allowed. */
  offer(nets, allow) {
    const mayWrite = this.mayWrite;
    this.nets = nets;
    this.allow = allow;
    if (mayWrite !== this.mayWrite && this.objects.length) this.draw();
    const places = nets.flatMap((net) => net.nodes.map((node) => [net.net, node.node, node.name]));
    const known = JSON.stringify(places);
    if (known === this.known) return;
    this.known = known;
    const text = (net, node) => (isOfFleet(nets[0]) ? nodeText(nets, net, node) : `${nets.length > 1 ? `net ${net}, ` : ""}${node}`);
    $("object-node").replaceChildren(...places.map(([net, node, name]) =>
      make("option", { value: `${net}/${node}` }, `${text(net, node)}${name ? ` ${name}` : ""}`)));
    if (this.place === null && places.length) this.choose(places[0][0], places[0][1]);
    else if (this.place !== null) $("object-node").value = this.place.join("/");
  }

  async choose(net, node) {
    this.place = [net, node];
    $("object-node").value = `${net}/${node}`;
    this.loading.abort();
    this.loading = new AbortController();
    try {
      this.objects = await ask("GET", `/${net}/${node}/objects`, undefined, this.loading.signal);
      this.draw();
    } catch (error) {
      if (error.name === "AbortError") return;
      this.objects = []; // those of the node before are none of this one
      this.draw();
      this.notice(error);
    }
  }

  draw() {
    const wanted = $("search").value.trim().toLowerCase();
    const found = this.objects.filter((each) => `${each.path} ${each.name}`.toLowerCase().includes(wanted));
    const head = make("tr", {}, ...["Object", "Name", "Value"].map((text) => make("th", { scope: "col" }, text)),
      make("th", { scope: "col" }, make("span", {}, "Actions")));
    $("objects").replaceChildren(make("table", {}, make("thead", {}, head),
      make("tbody", {}, ...found.slice(0, SHOWN).map((each) => this.row(each)))));
    const more = found.length - SHOWN;
    say($("objects-more"), found.length === 0 ? "No object has this in its name or number." : more > 0 ? `and ${more} more: search for one` : "");
  }

  row(object) {
    const [net, node] = this.place;
    const value = make("td", { class: "shown" });
    const path = `/${net}/${node}/objects/${object.path}`;
    const about = `${object.name} (${object.path})`;
    const read = make("button", { "aria-label": `Read ${about}` }, "Read");
    const watch = make("button", { "aria-label": `Watch ${about}` }, "Watch");
    read.addEventListener("click", () => this.read(path, value));
    watch.addEventListener("click", () => this.watch({ net, node, path: object.path, name: object.name }));
    const actions = make("td", {}, read, " ", watch);
    if (this.mayWrite && object.access !== "ro" && object.access !== "const") {
      const input = make("input", { class: "value", "aria-label": `New value of ${about}`, autocomplete: "off", spellcheck: false });
      const write = make("button", { "aria-label": `Write ${about}` }, "Write");
      const send = () => this.write(path, input.value, object.type, value);
      write.addEventListener("click", send);
      input.addEventListener("keydown", (event) => { if (event.key === "Enter") send(); });
      actions.append(" ", input, " ", write);
    }
    return make("tr", { title: `${object.type}, ${object.access}` }, make("td", { class: "place" }, object.path),
      make("td", { class: "name" }, ...breakable(object.name)), value, actions);
  }

  async read(path, cell) {
    say(cell, "…");
    try {
      const found = await ask("GET", path);
      const names = found.constants.length ? ` (${found.constants.join(", ")})` : "";
      say(cell, `${shown(found)}${found.unit ? ` ${found.unit}` : ""}${names}`);
    } catch (error) {
      say(cell, error.short ?? error.message);
      cell.title = (error.details ?? []).join("\n");
    }
  }

  async write(path, text, type, cell) {
    try {
      await ask("PUT", path, bodyOf(text, type));
      await this.read(path, cell);
    } catch (error) {
      say(cell, error.message);
      this.notice(error);
    }
  }
}
