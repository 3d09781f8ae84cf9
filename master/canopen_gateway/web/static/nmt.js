// NMT commands, to one node or to all of a net. All but Start ask before they are sent.

import { $, isOfFleet, make, nodeText, say, show } from "./dom.js";
import { ask } from "./link.js";
import { confirmed } from "./confirm.js";

const COMMANDS = [
  ["start", "Start", ""],
  ["preoperational", "Pre-operational", "Its PDOs stop: a drive that moves loses its commands."],
  ["stop", "Stop", "It takes NMT commands only, until it is started: a drive that moves loses its commands."],
  ["reset-communication", "Reset communication", "Its communication settings become those that it has stored, and its PDOs stop."],
  ["reset-node", "Reset node", "It starts anew, with the settings that it has stored: what moves there loses its power."],
];

export class NmtPanel {
  constructor(notice) {
    this.notice = notice;
    this.known = "";
    this.nets = [];
    this.allow = [];
    this.buttons = COMMANDS.map(([command, text, what]) => {
      const button = make("button", { type: "button", disabled: true, "aria-describedby": "nmt-why", "data-nmt": command }, text);
      button.addEventListener("click", () => this.send(command, text, what));
      return button;
    });
    $("nmt").append(...this.buttons);
    $("nmt-target").addEventListener("change", () => this.judge());
  }

  /** The nodes that there are, and whether commands are allowed. onlyOne: there is no command to all of a net. */
  update(nets, allow, onlyOne) {
    this.nets = nets;
    this.allow = allow;
    const several = nets.length > 1;
    const targets = nets.flatMap((net) => [...(onlyOne ? [] : [[`${net.net}`, several ? `all of net ${net.net}` : "all nodes"]]),
      ...net.nodes.map((node) => [`${net.net}/${node.node}`, `${nodeText(nets, net.net, node.node)}${node.name ? ` ${node.name}` : ""}`])]);
    const known = JSON.stringify(targets);
    if (known !== this.known) {
      this.known = known;
      const chosen = $("nmt-target").value;
      $("nmt-target").replaceChildren(...targets.map(([value, text]) => make("option", { value }, text)));
      if (targets.some(([value]) => value === chosen)) $("nmt-target").value = chosen;
    }
    this.judge();
  }

  /** Say whether the target takes a command. Over a fleet its bridge has to allow it, too. */
  judge() {
    const net = this.nets.find((each) => String(each.net) === $("nmt-target").value.split("/")[0]);
    const allowed = (net?.allow ?? this.allow).includes("nmt");
    const who = isOfFleet(net) ? "this page, or the bridge of this site," : "this gateway";
    say($("nmt-why"), allowed ? "" : `NMT commands are not allowed here: ${who} was started without --allow nmt.`);
    show($("nmt-why"), !allowed);
    for (const button of this.buttons) button.disabled = !allowed || !$("nmt-target").value;
  }

  choose(net, node) {
    $("nmt-target").value = `${net}/${node}`;
    this.judge();
  }

  async send(command, text, what) {
    const target = $("nmt-target").value;
    const where = $("nmt-target").selectedOptions[0].textContent;
    if (what && !await confirmed(`${text}: ${where}?`, what, text)) return;
    try {
      await ask("PUT", `/${target}/nmt`, { command });
      this.notice(`${text} was sent to ${where}.`);
    } catch (error) {
      this.notice(error);
    }
  }
}
