"use strict";
{
  const $ = (id) => document.getElementById(id);
  const MARGIN = { left: 62, right: 12, top: 6, bottom: 42 };
  const NEAR = 20; // pixels from a point at which it is meant
  const SAME = 1; // pixels within which points have one place on an axis
  const SQUARES = 3000; // points from which on circles would take too long
  // Corners of symbols as shares of their radius; other symbols are circles. | and x are strokes.
  const regular = (n) => Array.from({ length: n }, (_, i) => [Math.sin((2 * Math.PI * i) / n), -Math.cos((2 * Math.PI * i) / n)]);
  const CORNERS = {
    "^": [[0, -1], [1, 1], [-1, 1]],
    "<": [[-1, 0], [1, -1], [1, 1]],
    ">": [[1, 0], [-1, 1], [-1, -1]],
    v: [[0, 1], [1, -1], [-1, -1]],
    s: [[-1, -1], [1, -1], [1, 1], [-1, 1]],
    D: [[0, -1], [1, 0], [0, 1], [-1, 0]],
    d: [[0, -1], [0.6, 0], [0, 1], [-0.6, 0]],
    p: regular(5),
    h: regular(6),
    "*": regular(10).map(([a, b], n) => (n % 2 ? [0.382 * a, 0.382 * b] : [a, b])),
    P: [[-1, -3], [1, -3], [1, -1], [3, -1], [3, 1], [1, 1], [1, 3], [-1, 3], [-1, 1], [-3, 1], [-3, -1], [-1, -1]].map(([a, b]) => [a / 3, b / 3]),
    "|": [[0, -1], [0, 1]],
    x: [[-1, -1], [1, 1], [0, 0], [-1, 1], [1, -1], [0, 0]],
  };
  const SIGNS = { sweep_up: "\u25b2", sweep_down: "\u25bc", "not periodic": "\u25cb" };
  const numbers = (text) => new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const law = (mark) => mark.series.split(", ")[0];
  const off = new Set();
  const quiet = () => ($("tooltip").hidden = $("ring").hidden = true);

  // Scales: what is drawn is even in `to` of a number.
  const SCALES = {
    linear: () => ({ to: (v) => v, from: (u) => u }),
    log: () => ({ to: (v) => (v > 0 ? Math.log10(v) : NaN), from: (u) => 10 ** u }),
    // The linear part is as high as some decades.
    symlog: ({ threshold, decades }) => ({
      to: (v) => (Math.abs(v) <= threshold ? (decades * v) / threshold : Math.sign(v) * (decades + Math.log10(Math.abs(v) / threshold))),
      from: (u) => (Math.abs(u) <= decades ? (u * threshold) / decades : Math.sign(u) * threshold * 10 ** (Math.abs(u) - decades)),
    }),
  };

  class Axis {
    constructor(given) {
      Object.assign(this, given);
      this.use(SCALES[given.scale] ? given.scale : "linear");
    }
    use(scale, least = 0) {
      this.now = scale;
      Object.assign(this, SCALES[scale](this));
      const isCut = scale === "log" && Math.min(...this.limits) <= 0;
      const ends = this.limits.map((v) => this.to(isCut && v <= 0 ? least : v));
      const margin = isCut ? 0.03 * (ends[1] - ends[0]) : 0;
      this.view = this.whole = [ends[0] - margin, ends[1]];
    }
    show(low, high) {
      const part = Math.abs(high - low) / Math.abs(this.whole[1] - this.whole[0]);
      if (part > 1e-6 && part < 5) this.view = [low, high];
    }
    ticks(room) {
      const [low, high] = [...this.view].sort((a, b) => a - b);
      if (this.words) {
        const placed = this.words.map(([value, word]) => [this.to(value), word]);
        const shown = placed.filter(([at]) => at >= low && at <= high);
        return shown.filter((_, n) => n % Math.ceil(shown.length / room) === 0);
      }
      if (this.now === "log" && high - low > 0.6 && high - low < 2.5) {
        const found = [];
        for (let decade = Math.floor(low); decade <= high; decade++) for (const n of [1, 2, 5]) found.push(n * 10 ** decade);
        return found.map((v) => [this.to(v), written(v, 4)]).filter(([u]) => u >= low && u <= high);
      }
      const whole = this.now !== "linear" && high - low > 1.5;
      const [start, end] = whole ? [low, high] : [this.from(low), this.from(high)];
      let step = 10 ** Math.floor(Math.log10((end - start) / room));
      step *= [1, 2, 5, 10].find((n) => (end - start) / (n * step) <= room);
      if (whole) step = Math.max(1, Math.round(step));
      const found = [], digits = Math.ceil(Math.log10(Math.max(Math.abs(start), Math.abs(end)) / step)) + 1;
      for (let at = Math.ceil(start / step) * step; at <= end + 1e-9 * step; at += step) {
        const value = whole ? this.from(Math.round(at)) : Math.abs(at) < 1e-9 * step ? 0 : at;
        found.push([this.to(value), written(value, whole ? 4 : Math.max(digits, 4))]);
      }
      return found;
    }
  }

  const written = (value, digits = 6) => {
    const size = Math.abs(value);
    const text = size && (size < 1e-3 || size >= 1e5) ? value.toExponential().length > digits + 5 ? value.toExponential(digits - 1) : value.toExponential() : String(+value.toPrecision(digits));
    return text.replace(/\.?0+e/, "e").replace("e+", "e").replaceAll("-", "\u2212");
  };

  class Panel {
    constructor(given, panels) {
      Object.assign(this, given);
      // Panels that share an axis are moved together.
      for (const which of ["x", "y"]) this[which] = panels[given[which].view]?.[which] ?? new Axis(given[which]);
      this.label = { x: given.x.label, y: given.y.label };
      this.marks = given.marks.map((mark) => ({
        ...mark,
        ...Object.fromEntries(["x", "y", "end", "size"].map((name) => [name, numbers(mark[name])])),
      }));
      const box = document.createElement("figure");
      box.style.gridArea = `${given.row} / ${given.column[0]} / auto / ${given.column[1]}`;
      box.append(Object.assign(document.createElement("figcaption"), { textContent: given.title }));
      this.canvas = document.createElement("canvas");
      this.canvas.tabIndex = 0;
      this.canvas.setAttribute("role", "img");
      this.canvas.setAttribute("aria-label", `${given.title} ${this.label.y} over ${this.label.x}; arrows move, + and - zoom, 0 shows all`);
      box.append(this.canvas);
      $("panels").append(box);
      this.listen();
    }

    get shown() {
      return this.marks.filter((mark) => !off.has(law(mark)));
    }
    // Where a part of the panel ends, in pixels.
    across(part) {
      return MARGIN.left + part * (this.width - MARGIN.left - MARGIN.right);
    }
    up(part) {
      return this.height - MARGIN.bottom - part * (this.height - MARGIN.top - MARGIN.bottom);
    }
    place(which, value) {
      return this.shifted(which, this[which].to(value));
    }
    shifted(which, u) {
      const [low, high] = this[which].view, part = (u - low) / (high - low);
      return which === "x" ? this.across(part) : this.up(part);
    }
    at(which, pixel) {
      const { left, right, top, bottom } = MARGIN;
      const part = which === "x" ? (pixel - left) / (this.width - left - right) : (this.height - bottom - pixel) / (this.height - top - bottom);
      const [low, high] = this[which].view;
      return low + part * (high - low);
    }

    draw() {
      const { canvas } = this, sharp = devicePixelRatio || 1, pen = canvas.getContext("2d");
      this.width = canvas.clientWidth;
      this.height = canvas.clientHeight;
      canvas.width = this.width * sharp;
      canvas.height = this.height * sharp;
      pen.scale(sharp, sharp);
      pen.font = "12px system-ui, sans-serif";
      this.frame(pen);
      const { left, right, top, bottom } = MARGIN;
      pen.save();
      pen.beginPath();
      pen.rect(left, top - 4, this.width - left - right + 4, this.height - top - bottom + 5);
      pen.clip();
      for (const mark of this.shown) this[mark.kind](pen, mark);
      pen.restore();
      this.write(pen);
      // What is seen, for whoever tests or scripts the page.
      for (const which of ["x", "y"]) canvas.dataset[which] = this[which].view.map((end) => written(this[which].from(end))).join(" ");
    }
    frame(pen) {
      const { left, right, top, bottom } = MARGIN;
      const ends = { x: this.width - right, y: this.height - bottom };
      pen.strokeStyle = "#dddddd";
      pen.fillStyle = "#000000";
      for (const [which, room] of [["x", this.width / 90], ["y", this.height / 45]]) {
        for (const [u, text] of this[which].ticks(room)) {
          const at = this.shifted(which, u);
          pen.beginPath();
          if (which === "x") pen.moveTo(at, top), pen.lineTo(at, ends.y);
          else pen.moveTo(left, at), pen.lineTo(ends.x, at);
          pen.stroke();
          pen.textAlign = which === "x" ? "center" : "right";
          pen.textBaseline = which === "x" ? "top" : "middle";
          if (which === "x") pen.fillText(text, at, ends.y + 5);
          else pen.fillText(text, left - 5, at, left - 20);
        }
      }
      pen.strokeStyle = "#000000";
      pen.strokeRect(left, top, ends.x - left, ends.y - top);
      pen.textAlign = "center";
      pen.textBaseline = "bottom";
      pen.fillText(this.label.x, (left + ends.x) / 2, this.height - 2, ends.x);
      pen.save();
      pen.translate(13, (top + ends.y) / 2);
      pen.rotate(-Math.PI / 2);
      pen.fillText(this.label.y, 0, 0, ends.y);
      pen.restore();
    }
    write(pen) {
      pen.fillStyle = "#000000";
      for (const { text, x, y, in_data, ha, va } of this.texts) {
        pen.textAlign = ha;
        pen.textBaseline = { center: "middle", baseline: "alphabetic" }[va] ?? va;
        const at = in_data ? [this.place("x", x), this.place("y", y)] : [this.across(x), this.up(y)];
        text.split("\n").forEach((line, n) => pen.fillText(line, at[0], at[1] + 14 * n));
      }
    }
    look(pen, { colour, opacity, dashes, size }) {
      pen.globalAlpha = opacity;
      pen.strokeStyle = pen.fillStyle = colour;
      pen.lineWidth = (size[0] * 4) / 3;
      pen.lineJoin = "round"; // a mitre would stand above a peak
      pen.setLineDash({ "--": [6, 4], ":": [2, 3], "-.": [7, 3, 2, 3] }[dashes] ?? []);
    }
    line(pen, mark) {
      this.look(pen, mark);
      pen.beginPath();
      let on = false;
      mark.x.forEach((value, n) => {
        const x = this.place("x", value), y = this.place("y", mark.y[n]);
        if (Number.isNaN(x + y)) return void (on = false);
        on ? pen.lineTo(x, y) : (pen.moveTo(x, y), pen.lineTo(x + 0.5, y)); // one point alone shows, too
        on = true;
      });
      pen.stroke();
      if (mark.dots) this.point(pen, { ...mark, size: [mark.dots] });
    }
    point(pen, mark) {
      this.look(pen, mark);
      pen.lineWidth = 1;
      pen.setLineDash([]);
      mark.x.forEach((value, n) => {
        const x = this.place("x", value), y = this.place("y", mark.y[n]);
        const r = ((mark.size[n] ?? mark.size[0]) * 2) / 3;
        if (mark.x.length > SQUARES) return pen.fillRect(x - r, y - r, 2 * r, 2 * r);
        pen.beginPath();
        const corners = CORNERS[mark.marker];
        if (corners) corners.forEach(([a, b]) => pen.lineTo(x + a * Math.max(r, 1), y + b * Math.max(r, 1)));
        else pen.arc(x, y, Math.max(r, 1), 0, 2 * Math.PI);
        pen.closePath();
        mark.hollow || ["|", "x"].includes(mark.marker) ? pen.stroke() : pen.fill();
      });
    }
    tick(pen, mark) {
      this.look(pen, mark);
      for (const value of mark.x) pen.fillRect(this.place("x", value) - 1, MARGIN.top - 4, 2, 10);
    }
    band(pen, mark) {
      this.look(pen, mark);
      const { top, bottom } = MARGIN;
      mark.x.forEach((low, n) => {
        const left = this.place("x", low), right = this.place("x", mark.end[n]);
        pen.fillRect(left, top, Math.max(right - left, 1), this.height - top - bottom);
      });
    }
    level(pen, mark) {
      this.look(pen, mark);
      const x = this.place("x", mark.x[0]), y = this.place("y", mark.y[0]);
      pen.beginPath();
      for (const part of mark.end) pen.lineTo(Number.isNaN(x) ? this.across(part) : x, Number.isNaN(x) ? y : this.up(part));
      pen.stroke();
    }

    // What is under the pointer: the nearest point, others near it over the same place, and bands.
    under(x, y) {
      const near = [];
      for (const mark of this.shown) {
        if (mark.kind !== "point" && mark.kind !== "line") continue;
        let best = NEAR ** 2, found = null;
        mark.x.forEach((value, n) => {
          const [a, b] = [this.place("x", value), this.place("y", mark.y[n])], far = (a - x) ** 2 + (b - y) ** 2;
          if (far < best) (best = far), (found = { mark, far, x: a, y: b, at: [value, mark.y[n]] });
        });
        if (found) near.push(found);
      }
      near.sort((a, b) => a.far - b.far);
      const points = near.filter((one) => Math.abs(one.x - near[0].x) < SAME);
      const here = (mark) => mark.kind === "band" && mark.x.some((low, n) => this.place("x", low) <= x && x <= this.place("x", mark.end[n]));
      const bands = this.shown.filter((mark) => mark.series && here(mark)).map((mark) => mark.series);
      return { points, bands };
    }
    tell(event) {
      const box = this.canvas.getBoundingClientRect();
      const found = this.under(event.clientX - box.left, event.clientY - box.top);
      const [first] = found.points;
      // A law may draw a point twice: as a line, and with a ring.
      const values = new Set(found.points.map(({ mark, at }) => `${mark.series || "\u2013"}: ${this.value_of("y", at[1])}`));
      const lines = first ? [`${this.label.x || "x"}: ${this.value_of("x", first.at[0])}`, `${this.label.y || "y"}:`, ...values] : [];
      const tip = $("tooltip");
      tip.textContent = [...lines, ...new Set(found.bands)].join("\n");
      tip.hidden = !tip.textContent;
      $("ring").hidden = !first;
      const { clientX: x, clientY: y } = event, right = x > innerWidth / 2;
      Object.assign(tip.style, { left: right ? "" : `${x + 14}px`, right: right ? `${innerWidth - x + 14}px` : "", top: 0 });
      const below = y + 14 + tip.offsetHeight < innerHeight;
      tip.style.top = `${Math.max(0, below ? y + 14 : y - 14 - tip.offsetHeight)}px`;
      if (first) Object.assign($("ring").style, { left: `${box.left + first.x}px`, top: `${box.top + first.y}px` });
    }
    value_of(which, value) {
      const { words, named } = this[which];
      return (named && words.find(([at]) => at === Math.round(value))?.[1]) || written(value);
    }

    zoom(factor, x, y) {
      for (const [which, pixel] of [["x", x], ["y", y]]) {
        if (pixel === null) continue;
        const centre = this.at(which, pixel), [low, high] = this[which].view;
        this[which].show(centre + (low - centre) * factor, centre + (high - centre) * factor);
      }
      drawAll();
    }
    move(dx, dy) {
      for (const [which, by] of [["x", dx], ["y", dy]]) {
        const shift = this.at(which, 0) - this.at(which, by);
        this[which].show(...this[which].view.map((end) => end + shift));
      }
      drawAll();
    }
    reset() {
      for (const which of ["x", "y"]) this[which].view = this[which].whole;
      drawAll();
    }
    listen() {
      const { canvas } = this, held = new Map();
      canvas.addEventListener("wheel", (event) => {
        event.preventDefault();
        const { offsetX: x, offsetY: y } = event;
        const below = y > this.height - MARGIN.bottom, beside = x < MARGIN.left;
        this.zoom(1.002 ** event.deltaY, beside && !below ? null : x, below ? null : y);
      }, { passive: false });
      canvas.addEventListener("pointerdown", (event) => {
        held.set(event.pointerId, event);
        canvas.setPointerCapture(event.pointerId);
        if (event.pointerType === "touch") this.tell(event);
      });
      for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => held.delete(event.pointerId));
      canvas.addEventListener("pointermove", (event) => {
        const before = held.get(event.pointerId);
        if (!before) return this.tell(event);
        const other = [...held.values()].find((one) => one.pointerId !== event.pointerId);
        if (other) {
          const apart = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY) || 1;
          this.zoom(apart(before) / apart(event), (event.offsetX + other.offsetX) / 2, (event.offsetY + other.offsetY) / 2);
        } else this.move(event.clientX - before.clientX, event.clientY - before.clientY);
        held.set(event.pointerId, event);
      });
      canvas.addEventListener("pointerleave", quiet);
      canvas.addEventListener("dblclick", () => this.reset());
      canvas.addEventListener("keydown", (event) => {
        const moves = { ArrowLeft: [30, 0], ArrowRight: [-30, 0], ArrowUp: [0, 30], ArrowDown: [0, -30] };
        const zooms = { "+": 0.8, "=": 0.8, "-": 1.25 }, { key } = event;
        if (event.ctrlKey || event.metaKey) return;
        if (moves[key]) this.move(...moves[key]);
        else if (zooms[key]) this.zoom(zooms[key], this.width / 2, this.height / 2);
        else if (key === "0") this.reset();
        else return;
        event.preventDefault();
      });
    }
  }

  const data = JSON.parse($("data").textContent), panels = [];
  const build = (shown) => {
    $("panels").replaceChildren();
    $("panels").style.setProperty("--columns", Math.max(...shown.map(({ column }) => column[1])) - 1);
    $("panels").style.setProperty("--height", shown.some(({ row }) => row > 1) ? "17rem" : "24rem");
    panels.length = 0;
    for (const given of shown) panels.push(new Panel(given, panels));
    addSwitches();
  };
  let waiting = 0;
  const drawAll = () => {
    quiet();
    waiting ||= requestAnimationFrame(() => {
      waiting = 0;
      panels.forEach((panel) => panel.draw());
      if (parent !== window) parent.postMessage({ figure: document.documentElement.scrollHeight }, "*");
    });
  };

  const form = $("laws");
  const option = (text, checked, mark, change) => {
    const label = document.createElement("label"), box = document.createElement("input");
    Object.assign(box, { type: "checkbox", checked });
    box.addEventListener("change", () => (change(box.checked), drawAll()));
    label.append(box);
    if (mark) {
      const swatch = document.createElement("span");
      swatch.className = mark.kind === "line" ? "swatch line" : "swatch";
      swatch.style.borderTopColor = mark.colour;
      swatch.style.borderTopStyle = { "--": "dashed", "-.": "dashed", ":": "dotted" }[mark.dashes] ?? "solid";
      label.append(swatch);
    }
    label.append(text);
    form.append(label);
  };
  // Switches: laws, and logarithmic axes.
  const addSwitches = () => {
    form.replaceChildren();
    const laws = new Map();
    for (const { marks } of panels) for (const mark of marks) if (law(mark) && !laws.has(law(mark))) laws.set(law(mark), mark);
    if (laws.size > 1) for (const [name, mark] of laws) option(name, !off.has(name), mark, (on) => (on ? off.delete(name) : off.add(name)));
    const words = new Set(panels.flatMap(({ marks }) => marks.flatMap((mark) => mark.series.split(", ").slice(1))));
    form.append(...Object.entries(SIGNS).filter(([name]) => words.has(name)).map(([name, sign]) => `${sign} ${name}\u2003`));
    for (const which of ["x", "y"]) {
      const axes = [...new Set(panels.map((panel) => panel[which]))];
      const drawn = panels.flatMap((panel) => panel.marks.filter((mark) => mark.kind === "point" || mark.kind === "line"));
      const marks = drawn.map((mark) => mark[which]);
      const least = marks.reduce((a, m) => m.reduce((b, v) => (v > 0 && v < b ? v : b), a), Infinity);
      const negative = marks.some((m) => m.some((v) => v < 0));
      if (negative || least === Infinity || axes.some((axis) => axis.words || axis.now === "symlog")) continue;
      option(`log ${which}`, axes.every((axis) => axis.now === "log"), null, (on) => axes.forEach((axis) => axis.use(on ? "log" : "linear", least)));
    }
    form.hidden = !form.children.length;
  };
  build(data);
  // Other cases in the same panels.
  if ($("choices")) {
    const { looks, choices } = JSON.parse($("choices").textContent), [first] = data, select = $("case");
    const marksOf = (marks) => marks.map(([look, x, y]) => ({ ...looks[look], x, y }));
    const chosen = ({ limits, panels }) => panels.map(({ title, marks }, n) => ({
      ...first, title, column: [n + 1, n + 2], y: { ...first.y, limits }, texts: [], marks: marksOf(marks),
    }));
    select.append(new Option("as in the report", ""), ...choices.map(({ name }, n) => new Option(name, n)));
    select.addEventListener("change", () => (build(select.value ? chosen(choices[select.value]) : data), drawAll()));
    $("cases").hidden = false;
  }
  form.addEventListener("submit", (event) => event.preventDefault());
  $("help").hidden = false;
  if (parent !== window) document.documentElement.classList.add("framed");
  new ResizeObserver(drawAll).observe($("panels"));
  matchMedia("(resolution: 1dppx)").addEventListener("change", drawAll);
}
