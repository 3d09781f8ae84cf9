// Elements, made without markup: a string, whatever a device says, only ever becomes a text node or an attribute's value.

export const $ = (id) => document.getElementById(id);

/** Make an element. options: properties; `class`, `aria-...` and `data-...` as attributes. children: elements, or texts. */
export function make(tag, options = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(options)) {
    if (name === "class" || name.includes("-")) element.setAttribute(name, value);
    else element[name] = value;
  }
  element.append(...children.filter((child) => child !== null).map((child) => (child instanceof Node ? child : String(child))));
  return element;
}

/** Return "1 frame", "2 frames". what: in the singular. */
export function counted(number, what) {
  return `${number} ${what}${number === 1 ? "" : "s"}`;
}

/** Set the text of an element, if it is another one: so a screen reader hears only changes. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Show or hide an element. */
export function show(element, visible) {
  if (element.hidden === visible) element.hidden = !visible;
}

/** The parts of a name, with a place to break the line after each `_` and `:`. */
export function breakable(name) {
  return name.split(/(?<=[_:])/).flatMap((part) => [part, document.createElement("wbr")]);
}

const GOOD = new Set(["operational", "operation enabled", "following"]);
const BAD = new Set(["fault", "fault reaction active", "stopped", "not heard", "bus-off", "down", "emergency", "lost", "late", "finding"]);

/** A state in words, with its colour. */
export function badge(text) {
  const kind = GOOD.has(text) ? " good" : BAD.has(text) ? " bad" : "";
  return make("span", { class: `badge${kind}` }, text);
}

const UNITS = { degree: "°", radian: "\u00a0rad", millimetre: "\u00a0mm", turn: "\u00a0turns" };

/** A unit, as it stands behind a number. */
export function unitSign(unit) { return UNITS[unit] ?? (unit ? `\u00a0${unit}` : ""); }

/** How long ago something was, in a few letters. */
export function ago(seconds) {
  if (seconds < 100) return `${seconds.toFixed(1)} s ago`;
  return seconds < 6000 ? `${Math.round(seconds / 60)} min ago` : `${Math.round(seconds / 3600)} h ago`;
}

/** Whether a net is one of a fleet: its name then has its site, "hall-2/arm", and it says what its bridge allows. */
export function isOfFleet(net) { return net?.allow !== undefined; }

/** How a node is called where there may be several nets. */
export function nodeText(nets, netNumber, node) {
  const net = nets.find((each) => each.net === netNumber);
  if (isOfFleet(net)) return `${net.name}/${node}`;
  return nets.length > 1 ? `net ${netNumber}, node ${node}` : `node ${node}`;
}

export function number(value, digits = 3) {
  return typeof value === "number" ? (Number.isInteger(value) ? String(value) : value.toFixed(digits)) : "";
}
