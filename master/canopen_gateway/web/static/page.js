// The page: joins the live channel to what is shown.

import { $, ago, badge, isOfFleet, make, nodeText, number, say, show, unitSign } from "./dom.js";
import { ask, Live } from "./link.js";
import { Commissioning } from "./commission.js";
import { JogPanel } from "./jog.js";
import { Monitor } from "./monitor.js";
import { NetworkView } from "./network.js";
import { NmtPanel } from "./nmt.js";
import { ObjectBrowser } from "./objects.js";
import { Plot } from "./plot.js";

const LATE = 2.5; // s without a new value until it is marked as late
const STALE = 500; // ms without a message until the page turns grey
const MOST_EVENTS = 100;
const KINDS = { emergency: "emergency", lost: "lost" };

const plot = new Plot($("plot"));
let watched = []; // { net, node, path, name, curve, value }
let mark = 0; // of the present choice of values
let lastHeard = 0;
let isLost = true;
let allow = [];
let absent = {}; // what is not there, by a word, with the reason
let nets = [];
let drives = new Map(); // "net/node" -> what the drive shows, as it was read
let chosen = null;
let drivesRead = -Infinity;
let samples = 0; // so far: for tests

function notice(error) {
  const text = typeof error === "string" ? error : error.message;
  say($("notice"), text);
  $("notice").title = (error.details ?? []).join("\n");
  show($("notice"), text !== "");
}

const live = new Live({
  hello(message) {
    allow = message.allow;
    showAbsent(message.absent);
    jog.you = message.you;
    jog.mayMove = allow.includes("motion");
    say($("mode"), message.mode);
    $("mode").classList.toggle("warn", allow.length > 0);
    isLost = false;
    notice("");
    $("events").replaceChildren();
    message.events.forEach(showEvent);
    heard();
    showNets(message.nets);
    jog.update(message);
    if (browser.objects.length) browser.draw();
    sendWatched();
    if (monitor.isOn) monitor.send();
  },
  pulse(message) { heard(); jog.update(message); },
  nets(message) { showNets(message.nets); },
  event: showEvent,
  commission(message) { commissioning.said(message); },
  frames(message) { monitor.frames(message); },
  values(message) {
    if (message.mark !== mark) return; // of what was watched before: its numbers mean other objects
    samples += message.values.length;
    for (const [place, time, value, problem, late] of message.values) {
      const entry = watched[place];
      if (entry === undefined) continue;
      entry.problem = problem ?? "";
      entry.value = value;
      entry.came = performance.now() - 1000 * (late ?? 0);
      if (typeof value === "number") plot.put(entry.curve, time, value);
    }
  },
  error(message) {
    if (message.about === "renew" || message.about === "stop") return; // the lease is over: the pulse tells
    if (["take", "enable", "jog", "commission"].includes(message.about)) jog.lost();
    if (["take", "commission"].includes(message.about)) commissioning.lost(message.text);
    notice(message);
    $("notice").title = (message.details ?? []).join("\n");
    show($("notice"), true);
    say($("notice"), message.text);
  },
  halted(message) {
    notice(message.problems.length ? `Not all confirmed that they stand: ${message.problems.join("; ")}` : "Halted.");
  },
  closed() {
    isLost = true;
    jog.lost();
    commissioning.lost("The connection is lost: the drive was told to halt.");
  },
});

const jog = new JogPanel(live, notice);
const commissioning = new Commissioning(live, jog);
jog.over = (problem) => commissioning.lost(problem || "It was ended.");
const browser = new ObjectBrowser(notice, watch);
const nmt = new NmtPanel(notice);
const network = new NetworkView(notice);
const monitor = new Monitor(live);

function heard() { lastHeard = performance.now(); }

/** Say what this page does not have, and why; and hide its places. */
function showAbsent(found) {
  absent = found;
  const isFleet = Object.keys(found).length > 0;
  $("absent").replaceChildren(...Object.values(found).map((words) => make("li", {}, words)));
  show($("absent-section"), isFleet);
  show($("network-section"), !("network" in found));
  show($("monitor-section"), !("monitor" in found));
  show($("scan"), !("search" in found));
  $("halt").title = `Stops everything that ${isFleet ? "moves, at all sites" : "this master moves"}. Key: Escape`;
}

// ---- nodes and drives ----

function showNets(found) {
  nets = found;
  browser.offer(found, allow);
  nmt.update(found, allow, "nmt-all" in absent);
  if (!("network" in absent)) network.update(found);
  monitor.update(found);
  drawNets();
  if (chosen === null && found.some((net) => net.nodes.length)) {
    const net = found.find((each) => each.nodes.length);
    chosen = [net.net, net.nodes[0].node];
    if (isOfFleet(net)) readDrive(...chosen).then(() => showNets(nets));
  }
  showDrive();
  if (performance.now() - drivesRead > 4000 && !document.hidden) readDrives();
}

let drawnNets = "";

/** Draw the tables again only if more than an age has changed: else a button would vanish under a finger, or the keyboard. */
function drawNets() {
  const ages = [];
  const shape = JSON.stringify([nets, [...drives], chosen], (name, value) => {
    if (["bits", "position", "velocity", "statusword", "shown", "heard"].includes(name)) return undefined;
    if (name === "age") ages.push(value);
    return name === "age" ? value === null : value;
  });
  if (shape !== drawnNets) {
    drawnNets = shape;
    const focused = document.activeElement?.dataset?.node;
    $("nodes").replaceChildren(...nets.map(netTable));
    if (focused) document.querySelector(`[data-node="${CSS.escape(focused)}"]`)?.focus();
  }
  document.querySelectorAll("#nodes .age").forEach((cell, place) => say(cell, ages[place] === null ? "" : ago(ages[place])));
}

function netTable(net) {
  const isWell = ["error-active", "there"].includes(net.state);
  const title = make("h3", { class: "net" }, net.name, " ", isWell ? null : badge(net.state), net.age === undefined ? null : " ",
    net.age === undefined ? null : make("span", { class: "age quiet" }), net.outage ? ` ${net.outage}` : "");
  if (!net.nodes.length) return make("div", {}, title, make("p", { class: "quiet" }, "No node was heard yet."));
  const columns = ["Node", "Name", "State", "Drive"];
  const head = make("tr", {}, ...columns.map((text) => make("th", { scope: "col" }, text)), make("th", { scope: "col", class: "number wide" }, "Heard"));
  return make("div", {}, title, make("table", {}, make("thead", {}, head), make("tbody", {}, ...net.nodes.map((node) => nodeRow(net, node)))));
}

/** What a drive has shown when it was read. Over a fleet an old state is not shown: of a node that is not chosen, or is lost, no
 * more than its name. */
function readOf(net, node) {
  const read = drives.get(`${net?.net}/${node?.node}`);
  const isOld = isOfFleet(net) && (node.state === "lost" || chosen?.join("/") !== `${net.net}/${node.node}`);
  return isOld && read ? { name: read.name } : read;
}

function nodeRow(net, node) {
  const key = `${net.net}/${node.node}`;
  const read = readOf(net, node);
  const state = node.drives.length && node.drives[0].state !== "unknown" ? node.drives[0].state : read?.state;
  const open = make("button", { "aria-label": `Show ${nodeText(isOfFleet(net) ? [net] : [], net.net, node.node)}`, "aria-pressed": String(chosen?.join("/") === key), "data-node": key }, node.node);
  open.addEventListener("click", () => choose(net.net, node.node));
  const emergency = node.emergency === null ? null : badge("emergency");
  if (emergency) emergency.title = `${node.emergency.code} ${node.emergency.text}`;
  return make("tr", { class: chosen?.join("/") === key ? "chosen" : "" }, make("td", {}, open), make("td", {}, node.name || read?.name || ""),
    make("td", {}, badge(node.state), " ", emergency), make("td", {}, state ? badge(state) : ""),
    make("td", { class: "number wide age" }));
}

function choose(net, node) {
  chosen = [net, node];
  showNets(nets);
  browser.choose(net, node);
  nmt.choose(net, node);
  readDrive(net, node).then(() => showNets(nets));
}

/** Read the state of each drive, one after the other; of a node that is none it is not asked again. Over a fleet only the node that
 * is chosen is asked: each question goes over the network, and takes a turn of a bus. */
async function readDrives() {
  drivesRead = performance.now();
  for (const net of nets) {
    for (const node of net.nodes) {
      if (isOfFleet(net) && (node.state === "lost" || chosen?.join("/") !== `${net.net}/${node.node}`)) continue;
      const isTold = node.drives.some((drive) => drive.state !== "unknown"); // by its PDOs: nothing needs to be read
      if (!isTold && node.age !== null && node.age < 5) await readDrive(net.net, node.node);
    }
  }
  drawNets();
  showDrive();
}

async function readDrive(net, node) {
  const key = `${net}/${node}`;
  const known = drives.get(key);
  if (known?.isNone) return;
  try {
    const about = await ask("GET", `/${net}/${node}/about`);
    drives.set(key, { ...about.drive, name: about.name, isNone: about.drive === null && about.problem === "" });
  } catch (error) {
    notice(error);
  }
}

let drawnDrive = "";

function showDrive() {
  const [net, node] = chosen ?? [];
  const itsNet = nets.find((each) => each.net === net);
  const found = itsNet?.nodes.find((each) => each.node === node);
  const read = readOf(itsNet, found);
  const known = found?.drives.filter((each) => each.state !== "unknown") ?? [];
  const shown = known.length ? known : read?.state ? [read] : [];
  show($("drive-section"), shown.length > 0 || commissioning.isOn);
  commissioning.offer(shown.length && !("motion" in absent) ? [net, node] : null, allow.includes("motion"));
  if (!shown.length) return;
  const drawn = JSON.stringify([net, node, shown]);
  if (drawn === drawnDrive) return;
  drawnDrive = drawn;
  say($("drive-title"), `Drive: ${isOfFleet(itsNet) ? nodeText(nets, net, node) : `node ${node}`}${known.length ? ` ${known[0].name}` : ""}`);
  $("drive").replaceChildren(...shown.map(driveView));
}

function driveView(drive) {
  const facts = [badge(drive.state), drive.mode ? ` ${drive.mode}` : ""];
  if (drive.homed !== undefined) facts.push(drive.homed ? " · homed" : " · not homed");
  if (typeof drive.position === "number") facts.push(` · position ${number(drive.position)}${unitSign(drive.unit)}`);
  const view = make("div", {}, make("p", {}, ...facts));
  if (drive.error) view.append(make("p", {}, badge("fault"), ` ${drive.error.code} ${drive.error.text}`));
  if (drive.reasons.length) {
    view.append(make("p", { class: "quiet" }, "Why it does not move:"),
      make("ol", { class: "reasons" }, ...drive.reasons.map((reason) => make("li", {}, reason.what, make("span", { class: "quiet" }, ` – ${reason.remedy}`)))));
  } else {
    view.append(make("p", { class: "quiet" }, "Nothing keeps it from moving."));
  }
  const text = make("p", { class: "quiet" }, drive.shown);
  view.append(text);
  return view;
}

// ---- events ----

function showEvent(event) {
  const time = new Date(event.time * 1000);
  const kind = KINDS[event.kind] ?? event.kind;
  const where = event.place ?? nodeText(nets, event.net, event.node);
  const code = event.kind === "emergency" ? `${event.code} ` : "";
  const cleared = event.kind === "emergency" && event.code.startsWith("0x00");
  const mark = badge(cleared ? "cleared" : kind);
  $("events").prepend(make("li", {}, make("time", { dateTime: time.toISOString() }, time.toLocaleTimeString([], { hour12: false })), mark,
    make("span", {}, `${where}: ${code}${event.text}`)));
  while ($("events").children.length > MOST_EVENTS) $("events").lastElementChild.remove();
  show($("events-empty"), false);
}

// ---- watched values ----

function watch(place) {
  if (watched.some((each) => each.net === place.net && each.node === place.node && each.path === place.path)) return;
  const curve = plot.add(place.name);
  if (curve === null) {
    notice("Twelve values are watched already: remove one of them.");
    return;
  }
  watched.push({ ...place, curve, value: null, problem: "", came: performance.now() });
  sendWatched();
}

function forget(entry) {
  watched = watched.filter((each) => each !== entry);
  plot.remove(entry.curve);
  sendWatched();
}

function sendWatched() {
  mark += 1;
  live.send("watch", { objects: watched.map((each) => [each.net, each.node, each.path]), period: 0.1, mark });
  $("legend").replaceChildren(...watched.map(legendEntry));
  show($("plot-empty"), watched.length === 0);
  show($("plot-box"), watched.length > 0);
}

function legendEntry(entry) {
  const label = `${entry.name} of ${isOfFleet(nets.find((each) => each.net === entry.net)) ? nodeText(nets, entry.net, entry.node) : `node ${entry.node}`}`;
  entry.shown = make("span", { class: "value" });
  const toggle = make("button", { "aria-pressed": String(entry.curve.visible), "aria-label": `Show the curve of ${label}` }, "Show");
  toggle.addEventListener("click", () => {
    entry.curve.visible = !entry.curve.visible;
    toggle.setAttribute("aria-pressed", String(entry.curve.visible));
    plot.changed = true;
  });
  const remove = make("button", { "aria-label": `Do not watch ${label}` }, "×");
  remove.addEventListener("click", () => forget(entry));
  return make("li", {}, make("span", { class: `swatch curve-${entry.curve.slot}` }), label, entry.shown, toggle, remove);
}

// ---- the head of the page ----

$("halt").addEventListener("click", halt);
addEventListener("keydown", (event) => { if (event.key === "Escape") halt(); });

/** By both ways at once: the one that still works counts. */
function halt() {
  jog.release();
  const byLive = live.send("halt");
  ask("POST", "/halt").then(
    (done) => notice(done.problems.length ? `Not all confirmed that they stand: ${done.problems.join("; ")}` : "Halted."),
    (error) => { if (!byLive) notice(`HALT WAS NOT SENT: ${error.message}`); });
}

$("scan").addEventListener("click", async () => {
  $("scan").disabled = true;
  try {
    for (const net of nets) net.nodes = await ask("POST", `/${net.net}/scan`);
    showNets(nets);
  } catch (error) {
    notice(error);
  }
  $("scan").disabled = false;
});

$("pause").addEventListener("click", () => {
  plot.paused = !plot.paused;
  $("pause").setAttribute("aria-pressed", String(plot.paused));
});

setInterval(() => {
  const age = performance.now() - lastHeard;
  const stale = isLost || age > STALE;
  document.body.classList.toggle("stale", stale);
  say($("link"), isLost ? "connection lost" : stale ? "no news" : "live");
  $("link").classList.toggle("bad", stale);
  $("link").classList.toggle("good", !stale);
  say($("age"), stale && lastHeard ? `last value ${(age / 1000).toFixed(1)} s ago` : "");
  for (const entry of watched) {
    const text = entry.problem ? "cannot be read" : (typeof entry.value === "number" ? number(entry.value) : entry.value ?? "");
    if (!entry.shown) continue;
    const seconds = (performance.now() - entry.came) / 1000;
    const isLate = !entry.problem && seconds > LATE;
    say(entry.shown, `${text}${isLate ? ` late, ${ago(seconds)}` : ""}`);
    entry.shown.classList.toggle("warned", isLate);
    entry.shown.title = entry.problem;
  }
}, 200);

// What a test of the page looks at
window.canopenPage = { watch, get samples() { return samples; }, get frames() { return plot.frames; }, get watched() { return watched.length; } };
