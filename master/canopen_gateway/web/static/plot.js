// Curves of the last ten seconds on a canvas. Each curve keeps its samples in two rings. While samples come, each animation frame is
// drawn, so that the curves run smoothly; else only what has changed.

const SECONDS = 10;
const STILL = 500; // ms without a sample until the curves stand
const DRIFT = 2e-4; // of the clock of the samples against that of the browser, at most
const CAPACITY = 2048; // samples of a curve: ten seconds at 200 Hz
const COLOURS = 6;
const CURVES = 2 * COLOURS; // those of the second half are dashed

export class Curve {
  constructor(label, slot) {
    this.label = label;
    this.slot = slot; // its colour, and whether it is dashed: 1 to 12
    this.visible = true;
    this.times = new Float64Array(CAPACITY);
    this.values = new Float64Array(CAPACITY);
    this.count = 0;
    this.last = null;
  }

  put(time, value) {
    if (this.count && time < this.times[(this.count - 1) % CAPACITY] - 1) this.count = 0; // the door was started anew
    this.times[this.count % CAPACITY] = time;
    this.values[this.count % CAPACITY] = value;
    this.count += 1;
    this.last = value;
  }

  /** Call `take` with time and value of each sample after a time, oldest first. */
  each(after, take) {
    let first = this.count;
    const least = Math.max(0, this.count - CAPACITY);
    while (first > least && this.times[(first - 1) % CAPACITY] >= after) first -= 1;
    for (let at = first; at < this.count; at += 1) take(this.times[at % CAPACITY], this.values[at % CAPACITY]);
  }
}

export class Plot {
  constructor(canvas) {
    this.canvas = canvas;
    this.curves = [];
    this.paused = false;
    this.zero = 0; // s from the browser's clock to that of the samples: by those that came soonest
    this.came = -Infinity; // when the newest sample came
    this.changed = true;
    this.frames = 0;
    new ResizeObserver(() => { this.changed = true; }).observe(canvas.parentElement);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { this.changed = true; });
    const frame = () => {
      const runs = this.curves.length > 0 && performance.now() - this.came < STILL;
      if ((this.changed || runs) && !this.paused) this.draw();
      requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  /** Add a curve, or return null if there are as many as there are colours. */
  add(label) {
    const used = new Set(this.curves.map((curve) => curve.slot));
    for (let slot = 1; slot <= CURVES; slot += 1) {
      if (!used.has(slot)) {
        const curve = new Curve(label, slot);
        this.curves.push(curve);
        this.changed = true;
        return curve;
      }
    }
    return null;
  }

  remove(curve) {
    this.curves = this.curves.filter((each) => each !== curve);
    this.changed = true;
  }

  put(curve, time, value) {
    curve.put(time, value);
    const now = performance.now();
    const zero = time - now / 1000;
    this.zero -= ((now - Math.max(this.came, 0)) / 1000) * DRIFT;
    if (zero > this.zero || zero < this.zero - 1) this.zero = zero;
    this.came = now;
    this.changed = true;
  }

  draw() {
    this.changed = false;
    this.frames += 1;
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    const scale = devicePixelRatio || 1;
    if (this.canvas.width !== Math.round(width * scale) || this.canvas.height !== Math.round(height * scale)) {
      this.canvas.width = Math.round(width * scale);
      this.canvas.height = Math.round(height * scale);
    }
    const context = this.canvas.getContext("2d");
    const style = getComputedStyle(document.documentElement);
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.clearRect(0, 0, width, height);
    const end = Math.min(performance.now(), this.came + STILL) / 1000 + this.zero;
    const from = end - SECONDS;
    let low = Infinity;
    let high = -Infinity;
    const shown = this.curves.filter((curve) => curve.visible);
    for (const curve of shown) {
      curve.each(from, (time, value) => {
        if (value < low) low = value;
        if (value > high) high = value;
      });
    }
    if (!(high >= low)) return;
    if (high === low) { low -= 1; high += 1; }
    const room = (high - low) * 0.08;
    low -= room;
    high += room;
    const box = { left: 64, top: 8, right: width - 8, bottom: height - 22 };
    const x = (time) => box.left + ((time - from) / SECONDS) * (box.right - box.left);
    const y = (value) => box.bottom - ((value - low) / (high - low)) * (box.bottom - box.top);
    context.font = "12px system-ui, sans-serif";
    context.fillStyle = style.getPropertyValue("--quiet");
    context.strokeStyle = style.getPropertyValue("--line");
    context.lineWidth = 1;
    context.textAlign = "right";
    context.textBaseline = "middle";
    const step = niceStep((high - low) / 4);
    for (let value = Math.ceil(low / step) * step; value <= high; value += step) {
      line(context, box.left, y(value), box.right, y(value));
      context.fillText(tick(value, step), box.left - 6, y(value));
    }
    context.textAlign = "center";
    context.textBaseline = "top";
    for (let back = SECONDS; back >= 0; back -= 2) {
      context.fillText(back ? `−${back} s` : "now", Math.min(x(end - back), box.right - 12), box.bottom + 6);
    }
    context.lineWidth = 1.6;
    context.lineJoin = "round";
    for (const curve of shown) {
      context.strokeStyle = style.getPropertyValue(`--curve-${((curve.slot - 1) % COLOURS) + 1}`);
      context.setLineDash(curve.slot > COLOURS ? [6, 3] : []);
      context.beginPath();
      let begun = false;
      curve.each(from, (time, value) => {
        if (begun) context.lineTo(x(time), y(value));
        else context.moveTo(x(time), y(value));
        begun = true;
      });
      context.stroke();
    }
    context.setLineDash([]);
  }
}

function line(context, x1, y1, x2, y2) {
  context.beginPath();
  context.moveTo(x1, Math.round(y1) + 0.5);
  context.lineTo(x2, Math.round(y2) + 0.5);
  context.stroke();
}

function niceStep(rough) {
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((each) => each * power).find((each) => each >= rough);
}

function tick(value, step) {
  if (Math.abs(value) >= 1e6 || (step < 1e-3 && value !== 0)) return value.toExponential(2);
  return value.toFixed(Math.max(0, Math.min(6, -Math.floor(Math.log10(step)))));
}
