// The hand on the machine. A joint moves while its button, or its key, is held: one message each 100 ms, each good for 0.3 s by the
// clock of the gateway. Whatever lets go, the messages end.

import { $, badge, counted, make, say, show, unitSign } from "./dom.js";

const RENEW = 100; // ms between two messages

export class JogPanel {
  constructor(live, notice) {
    this.live = live;
    this.notice = notice;
    this.mayMove = false;
    this.you = "";
    this.wasMine = false;
    this.sequence = 0;
    this.held = null; // { chain, joint, way }
    this.timer = null;
    this.over = () => {}; // called with the reason when the lease has ended by itself
    this.rows = new Map();
    this.shape = "";
    for (const event of ["blur", "pagehide"]) addEventListener(event, () => this.release());
    document.addEventListener("visibilitychange", () => { if (document.hidden) this.giveUp(); });
  }

  /** The chains as they are now; the panel is built again only if there are others. */
  update(pulse) {
    this.lease = pulse.lease;
    const shape = JSON.stringify([this.mayMove, pulse.chains.map((chain) => [chain.name, chain.joints.map((joint) => joint.name)])]);
    if (shape !== this.shape) {
      this.shape = shape;
      this.build(pulse.chains);
    }
    show($("jog-section"), pulse.chains.length > 0);
    for (const chain of pulse.chains) {
      const row = this.rows.get(chain.name);
      row.state.replaceChildren(badge(chain.state), chain.missed ? ` ${counted(chain.missed, "cycle")} missed` : "");
      const mine = this.isMine();
      row.power.disabled = !this.mayMove || pulse.lease.doing === "enable" || (pulse.lease.owner !== null && !mine);
      say(row.power, mine ? "Let go of the machine" : "Take the machine, and give power");
      const ready = mine && chain.state === "following" && ["", "jog"].includes(pulse.lease.doing);
      const owner = pulse.lease.owner;
      say(row.owner, owner === null ? pulse.lease.problem : mine ? pulse.lease.doing || "you move it" : `${owner} moves it`);
      chain.joints.forEach((joint, place) => {
        const { position, buttons } = row.joints[place];
        say(position, joint.position === null ? "" : `${joint.position.toFixed(3)}${unitSign(joint.unit)}`);
        for (const button of buttons) button.disabled = !ready;
      });
    }
    if (this.wasMine && !this.isMine()) { this.lost(); this.over(pulse.lease.problem); } // it is over: by its time, or by somebody's halt
    this.wasMine = this.isMine();
  }

  isMine() { return this.lease !== undefined && this.lease.owner !== null && this.lease.owner === this.you; }

  build(chains) {
    this.release();
    this.rows.clear();
    $("jog").replaceChildren(...chains.map((chain) => this.buildChain(chain)));
  }

  buildChain(chain) {
    const state = make("span");
    const owner = make("span", { class: "quiet", role: "status" });
    const power = make("button", {}, "Take the machine, and give power");
    const speed = make("input", { type: "range", min: 1, max: 100, value: 10, "aria-label": `Speed of ${chain.name}, in percent of its limit` });
    const shown = make("output", {}, "10 %");
    speed.addEventListener("input", () => say(shown, `${speed.value} %`));
    power.addEventListener("click", () => (this.isMine() ? this.giveUp() : this.take(chain.name)));
    const joints = chain.joints.map((joint, place) => {
      const position = make("span", { class: "number" });
      const buttons = [-1, 1].map((way) => this.buildButton(chain, place, way, speed));
      return { position, buttons, row: make("div", { class: "joint" }, make("span", {}, joint.name), ...buttons, position) };
    });
    this.rows.set(chain.name, { state, owner, power, joints });
    return make("div", { "data-chain": chain.name },
      make("div", { class: "row" }, make("strong", {}, chain.name), state, owner),
      make("div", { class: "row" }, power, make("label", {}, "Speed ", speed, " ", shown)),
      this.mayMove ? null : make("p", { class: "quiet" }, "Moving is not allowed here: this gateway was started without --allow motion."),
      ...joints.map((joint) => joint.row));
  }

  buildButton(chain, place, way, speed) {
    const name = chain.joints[place].name;
    const label = `Hold to move ${name} ${way > 0 ? "forward" : "back"}`;
    const button = make("button", { disabled: true, "aria-label": label, title: label }, way > 0 ? "+" : "−");
    const hold = () => this.hold(chain, place, way, Number(speed.value) / 100);
    button.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      button.setPointerCapture(event.pointerId);
      hold();
    });
    for (const event of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) {
      button.addEventListener(event, () => this.release());
    }
    button.addEventListener("keydown", (event) => {
      if (event.key !== " " && event.key !== "Enter") return;
      event.preventDefault();
      if (!event.repeat) hold();
    });
    button.addEventListener("keyup", () => this.release());
    button.addEventListener("contextmenu", (event) => event.preventDefault()); // a long touch
    return button;
  }

  next() {
    this.sequence += 1;
    return this.sequence;
  }

  /** Take the lease, and give the joints power. */
  take(chain) {
    this.holdMachine();
    this.live.send("enable", { n: this.next(), chain });
  }

  /** Take the lease, and show from now on that somebody is here. */
  holdMachine() {
    this.sequence = 0;
    this.notice("");
    this.live.send("take");
    this.begin();
  }

  begin() {
    clearInterval(this.timer);
    this.timer = setInterval(() => this.beat(), RENEW);
  }

  beat() {
    if (this.held === null) this.live.send("renew", { n: this.next() });
    else this.live.send("jog", { n: this.next(), chain: this.held.chain, velocities: this.held.velocities });
  }

  hold(chain, place, way, share) {
    if (!this.isMine()) return;
    const velocities = chain.joints.map((joint, at) => (at === place ? way * share * joint.speed : 0));
    this.held = { chain: chain.name, velocities };
    this.beat();
  }

  /** Let go of the button: the joints brake, and stay enabled. */
  release() {
    if (this.held === null) return;
    const { chain, velocities } = this.held;
    this.held = null;
    this.live.send("jog", { n: this.next(), chain, velocities: velocities.map(() => 0) });
    this.live.send("stop", { n: this.next() });
  }

  /** Let go of the machine: it is halted. */
  giveUp() {
    this.release();
    clearInterval(this.timer);
    this.timer = null;
    this.live.send("leave");
  }

  /** The door refused something of ours, or the connection is gone. */
  lost() {
    this.held = null;
    clearInterval(this.timer);
    this.timer = null;
  }
}
