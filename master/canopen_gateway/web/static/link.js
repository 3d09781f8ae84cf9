// The connection to the door: requests by HTTP, and the live channel, which is opened again when it ends.

const AGAIN = 1000; // ms until the live channel is tried again

export class DoorError extends Error {
  constructor(status, error) {
    super(error.text);
    this.status = status;
    this.short = error.abort_text;
    this.details = error.details ?? [];
  }
}

/** Ask the door, and return its answer. body: is sent as JSON; a text is JSON already. signal: of an AbortController. */
export async function ask(method, path, body = undefined, signal = undefined) {
  const options = { method, signal, headers: { "x-canopen": "1" } };
  if (body !== undefined) {
    options.headers["content-type"] = "application/json";
    options.body = typeof body === "string" ? body : JSON.stringify(body);
  }
  const answer = await fetch(`/api/v1${path}`, options);
  const text = await answer.text();
  if (!answer.ok) {
    let error = { text: text.trim() || `the door answers ${answer.status}` };
    try { error = JSON.parse(text).error ?? error; } catch { /* no JSON: something in between has answered */ }
    throw new DoorError(answer.status, error);
  }
  return JSON.parse(text);
}

export class Live {
  /** on: functions by the kind of message; `open` and `closed` besides. */
  constructor(on) {
    this.on = on;
    this.socket = null;
    this.connect();
  }

  get isOpen() { return this.socket !== null && this.socket.readyState === WebSocket.OPEN; }

  connect() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    this.socket = new WebSocket(`${scheme}://${location.host}/api/v1/live`);
    this.socket.onmessage = (message) => {
      const heard = JSON.parse(message.data);
      this.on[heard.k]?.(heard);
    };
    this.socket.onclose = (event) => {
      this.on.closed(event);
      setTimeout(() => this.connect(), AGAIN);
    };
  }

  /** Send a message, unless too much waits already: an old intent must not arrive late. Return whether it was sent. */
  send(kind, fields = {}) {
    if (!this.isOpen || this.socket.bufferedAmount > 4096) return false;
    this.socket.send(JSON.stringify({ k: kind, ...fields }));
    return true;
  }
}
