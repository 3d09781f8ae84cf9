// Who sends which PDO to whom, how often it came, and how much of the bus each node takes: a picture, and the tables that say the same.

import { $, breakable, counted, make, say } from "./dom.js";
import { ask } from "./link.js";

const EACH = 2000; // ms between two looks, while the view is seen
const MOST_LINES = 60; // of the picture; more are told by the table alone
const SVG = "http://www.w3.org/2000/svg";

function drawn(tag, attributes, text = "") {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  if (text) element.textContent = text;
  return element;
}

function endText(end) {
  const who = end.node === 0 ? end.name : `${end.node}${end.name ? ` ${end.name}` : ""}`;
  return end.pdo ? `${who}, ${end.pdo}` : who;
}

function endKey(end) { return end.node === 0 ? end.name : `node ${end.node}${end.name ? ` ${end.name}` : ""}`; }

function loadText(bits, load) {
  const rate = bits >= 1e5 ? `${(bits / 1000).toFixed(0)} kbit/s` : `${(bits / 1000).toFixed(1)} kbit/s`;
  return load === null ? rate : `${(100 * load).toFixed(1)} % (${rate})`;
}

export class NetworkView {
  constructor(notice) {
    this.notice = notice;
    this.nets = [];
    this.parts = new Map(); // net -> { root, shape, cells }
    this.isSeen = false;
    this.isAsking = false;
    this.asked = -Infinity;
    new IntersectionObserver((entries) => { this.isSeen = entries.some((entry) => entry.isIntersecting); }).observe($("network-section"));
    $("network-read").addEventListener("click", () => this.readAll());
    setInterval(() => this.look(), 500);
  }

  update(nets) { this.nets = nets; }

  look() {
    if (!this.isSeen || document.hidden || this.isAsking || performance.now() - this.asked < EACH) return;
    this.refresh();
  }

  async refresh() {
    this.isAsking = true;
    try {
      for (const { net } of this.nets) this.draw(await ask("GET", `/${net}/network`));
    } catch { /* the top of the page says that the connection is lost */ }
    this.asked = performance.now();
    this.isAsking = false;
  }

  /** Ask each node for its PDOs, one after the other. */
  async readAll() {
    const button = $("network-read");
    button.disabled = true;
    const problems = [];
    for (const net of this.nets) {
      for (const node of net.nodes) {
        say($("network-reading"), `Reading node ${node.node} …`);
        try {
          await ask("GET", `/${net.net}/${node.node}/pdos`);
        } catch (error) {
          problems.push(`node ${node.node}: ${error.message}`);
        }
      }
    }
    say($("network-reading"), problems.length ? `Not read: ${problems.join("; ")}` : "");
    button.disabled = false;
    await this.refresh();
  }

  draw(network) {
    let part = this.parts.get(network.net);
    if (part === undefined) {
      part = { root: make("div"), shape: "" };
      this.parts.set(network.net, part);
      $("network").append(part.root);
    }
    const width = Math.round($("network").clientWidth);
    const shape = JSON.stringify([width, network.name, network.notes, network.pdos.map((pdo) => ({ ...pdo, frames_per_second: 0, bits_per_second: 0, load: 0 })),
      network.nodes.map((node) => [node.node, node.name, node.pdos])]);
    if (shape !== part.shape) {
      part.shape = shape;
      this.build(part, network, width);
    }
    say(part.sum, this.sumText(network));
    network.pdos.forEach((pdo, place) => {
      say(part.rates[place], String(pdo.frames_per_second));
      say(part.loads[place], loadText(pdo.bits_per_second, pdo.load));
    });
    network.nodes.forEach((node, place) => {
      say(part.frames[place], String(node.frames_per_second));
      say(part.shares[place], loadText(node.bits_per_second, node.load));
    });
    this.thicken(part, network);
  }

  sumText(network) {
    const missing = network.lost + network.dropped;
    return `${counted(network.frames_per_second, "frame")} in the last second, ${loadText(network.bits_per_second, network.load)}${
      network.bitrate ? ` of ${network.bitrate / 1000} kbit/s` : "; nobody tells the bit rate, so there is no load"}${
      missing ? `; ${counted(missing, "frame")} lost or not looked at` : ""}`;
  }

  build(part, network, width) {
    part.sum = make("p", { class: "quiet" });
    const several = this.nets.length > 1;
    const title = several ? make("h3", { class: "net" }, network.name) : null;
    part.rates = network.pdos.map(() => make("td", { class: "number" }));
    part.loads = network.pdos.map(() => make("td", { class: "number" }));
    part.frames = network.nodes.map(() => make("td", { class: "number" }));
    part.shares = network.nodes.map(() => make("td", { class: "number" }));
    const head = (...columns) => make("thead", {}, make("tr", {}, ...columns.map(([text, kind]) => make("th", { scope: "col", class: kind ?? "" }, text))));
    const pdos = make("table", { class: "cards" }, make("caption", {}, "PDOs: who sends to whom"),
      head(["CAN-ID"], ["From"], ["To"], ["Objects"], ["A second", "number"], ["Load", "number"]),
      make("tbody", {}, ...network.pdos.map((pdo, place) => make("tr", {},
        make("td", { class: "place", "data-label": "CAN-ID" }, pdo.can_id), this.ends(pdo.senders, "From", "nobody here"), this.ends(pdo.receivers, "To", "nobody here"),
        make("td", { "data-label": "Objects" }, make("span", {}, ...breakable(pdo.objects || "not known"), this.when(pdo))), this.labelled(part.rates[place], "A second"), this.labelled(part.loads[place], "Load")))));
    const nodes = make("table", { class: "cards" }, make("caption", {}, "What each node takes of the bus"),
      head(["Node"], ["Name"], ["Its PDOs are known from"], ["Frames a second", "number"], ["Load", "number"]),
      make("tbody", {}, ...network.nodes.map((node, place) => make("tr", {}, make("th", { scope: "row", "data-label": "Node" }, node.node || "–"), make("td", { "data-label": "Name" }, make("span", {}, node.name)),
        make("td", { "data-label": "PDOs known from" }, node.pdos || "nothing"), this.labelled(part.frames[place], "Frames a second"), this.labelled(part.shares[place], "Load")))));
    part.picture = this.picture(part, network, width);
    part.root.replaceChildren(...[title, part.sum, part.picture, network.pdos.length ? pdos : make("p", { class: "quiet" }, "No PDO is known, and none was heard."),
      nodes, ...network.notes.map((note) => make("p", { class: "quiet" }, note))].filter((each) => each !== null));
  }

  labelled(cell, label) {
    cell.dataset.label = label;
    return cell;
  }

  ends(ends, label, nobody) {
    const texts = ends.map((end) => make("span", { class: "end", title: `known from ${end.known}` }, endText(end)));
    return make("td", { "data-label": label }, make("span", {}, ...(texts.length ? texts : [make("span", { class: "quiet" }, nobody)])));
  }

  when(pdo) {
    const facts = [pdo.sent, pdo.links.length ? `by ${pdo.links.join(", ")} of the machine file` : "", pdo.bytes === null ? "" : counted(pdo.bytes, "byte")].filter(Boolean);
    return facts.length ? make("span", { class: "quiet small" }, facts.join(", ")) : null;
  }

  /** The pairs of who sends and who receives, with the numbers of their PDOs in the table. */
  pairs(network) {
    const found = new Map();
    network.pdos.forEach((pdo, place) => {
      for (const from of pdo.senders) {
        for (const to of pdo.receivers) {
          const key = JSON.stringify([endKey(from), endKey(to)]);
          found.set(key, [...(found.get(key) ?? []), place]);
        }
      }
    });
    return [...found].map(([key, places]) => [...JSON.parse(key), places]);
  }

  picture(part, network, width) {
    const pairs = this.pairs(network);
    part.lines = [];
    if (!pairs.length) return null;
    if (pairs.length > MOST_LINES) return make("p", { class: "quiet" }, `${pairs.length} pairs of nodes are too many for a picture: the table has them.`);
    const froms = [...new Set(pairs.map(([from]) => from))];
    const tos = [...new Set(pairs.map(([, to]) => to))];
    const step = 34;
    const top = 30;
    const height = top + step * Math.max(froms.length, tos.length);
    const box = Math.min(150, Math.floor(width * 0.36));
    const letters = Math.floor((box - 12) / 7.2);
    const svg = drawn("svg", { viewBox: `0 0 ${width} ${height}`, width, height, class: "picture", role: "img",
      "aria-label": `Picture: ${pairs.map(([from, to]) => `${from} sends to ${to}`).join("; ")}. The table below says the same.` });
    const middle = (list, at) => top + step * at + 13 + ((Math.max(froms.length, tos.length) - list.length) * step) / 2;
    for (const [text, x] of [["sends", 0], ["receives", width - box]]) svg.append(drawn("text", { x: x + box / 2, y: 16, class: "side" }, text));
    for (const [from, to, places] of pairs) {
      const [y1, y2] = [middle(froms, froms.indexOf(from)), middle(tos, tos.indexOf(to))];
      const bend = (width - 2 * box) / 2;
      const line = drawn("path", { d: `M ${box} ${y1} C ${box + bend} ${y1}, ${width - box - bend} ${y2}, ${width - box} ${y2}`, class: "flow" });
      line.append(drawn("title", {}, `${from} to ${to}: ${places.map((place) => network.pdos[place].can_id).join(", ")}`));
      part.lines.push([line, places]);
      svg.append(line);
    }
    for (const [list, x] of [[froms, 0], [tos, width - box]]) {
      list.forEach((name, at) => {
        const y = middle(list, at);
        svg.append(drawn("rect", { x: x + 0.5, y: y - 13, width: box - 1, height: 26, rx: 5 }));
        svg.append(drawn("text", { x: x + box / 2, y: y + 4.5 }, name.length > letters ? `${name.slice(0, letters - 1)}…` : name));
      });
    }
    return svg;
  }

  /** A line is as thick as its PDOs come often; dashed if none came in the last second. */
  thicken(part, network) {
    for (const [line, places] of part.lines) {
      const rate = places.reduce((sum, place) => sum + (network.pdos[place]?.frames_per_second ?? 0), 0);
      line.setAttribute("stroke-width", String(rate ? Math.min(6, 1 + Math.log10(1 + rate) * 1.6) : 1));
      line.classList.toggle("still", rate === 0);
    }
  }
}
