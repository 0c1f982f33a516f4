// Drift against distance for every route, with the limit; the selected route in front, and a cursor that reads values.
import { same } from "./calculator.js";
import { CURVE_PIXELS, el, metres, resized, roundNumber, stroked } from "./dom.js";

const RIGHT = 14, TOP = 12;

export class Chart {
  constructor(studio) {
    this.studio = studio;
    [this.still, this.live] = [el("canvas", { "aria-hidden": "true" }), el("canvas", { "aria-hidden": "true" })];
    this.node = el("div", { class: "chart", tabindex: "0", role: "slider", "aria-label": "Drift along the selected route",
      "aria-valuemin": "0", onkeydown: (event) => this.key(event), onpointermove: (event) => this.hover(event), onpointerdown: (event) => this.hover(event),
      onpointerleave: ({ pointerType }) => pointerType === "mouse" && this.studio.setCursor(null) }, this.still, this.live);
  }

  resize() {
    resized(this, this.still, this.live);
    [this.left, this.bottom] = [52 * this.unit, 34 * this.unit];
  }

  draw({ scene, drifts, others, most, stays }, theme) {
    if (!this.width) return;
    const { selected } = this.studio.session;
    const routes = scene.routes.map((route, k) => ({ route, drift: drifts[k], other: others[k], k }))
      .filter(({ drift }) => !(drift instanceof Error));
    const length = Math.max(1e-9, ...routes.map(({ drift }) => drift.length));
    const limits = scene.routes.map(({ limit_m: limit }) => limit ?? 0), top = 1.08 * Math.max(most, ...limits);
    this.x = (s) => this.left + s / length * (this.width - this.left - RIGHT);
    this.y = (rms) => this.height - this.bottom - rms / top * (this.height - TOP - this.bottom);
    this.span = length;
    const chosen = routes.find(({ k }) => k === selected.route), spacing = CURVE_PIXELS * length / this.width;
    const key = [spacing, length, top, this.height].join(), still = routes.filter(({ k }) => stays[k]);
    const state = [theme, key, selected.route, chosen?.route.limit_m, ...still.flatMap(({ drift, other }) => [drift, other])];
    if (!same(state, this.drawnStill)) this.drawSome(this.drawAxes(this.still, theme, length, top), theme, still, key, spacing);
    this.drawnStill = state;
    const pen = this.live.getContext("2d");
    pen.clearRect(0, 0, this.width, this.height);
    pen.font = `${12 * this.unit}px system-ui, sans-serif`;
    this.drawSome(pen, theme, routes.filter(({ k }) => !stays[k]), key, spacing);
    if (chosen) this.drawCursor(pen, theme, chosen.drift);
    const { message } = drifts[selected.route] ?? {};  // of an Error
    if (message) Object.assign(pen, { fillStyle: theme.text }).fillText(message, this.left + 8, TOP + 14);
  }

  /** The curves of some routes, the selected one on top. */
  drawSome(pen, theme, routes, key, spacing) {
    const line = (drift) => {  // what is drawn is kept with the drift
      if (drift.charted?.key !== key) {
        drift.charted = { key, curve: new Path2D() };
        for (const [s, rms] of drift.curve(spacing)) drift.charted.curve.lineTo(this.x(s), this.y(rms));
      }
      pen.stroke(drift.charted.curve);
    };
    const chosen = routes.find(({ k }) => k === this.studio.session.selected.route);
    Object.assign(pen, { lineWidth: 1, strokeStyle: theme.route });
    for (const one of routes) if (one !== chosen) line(one.drift);
    if (!chosen) return;
    this.drawLimit(pen, theme, chosen.route.limit_m);
    if (chosen.other && !(chosen.other instanceof Error)) {
      Object.assign(pen, { strokeStyle: theme.other, lineWidth: 2 });
      pen.setLineDash([7, 5]);
      line(chosen.other);
      pen.setLineDash([]);
    }
    Object.assign(pen, { strokeStyle: theme.accent, lineWidth: 2.5 * this.unit });
    line(chosen.drift);
  }

  /** The empty chart on a canvas, whose pen this returns. */
  drawAxes(canvas, theme, length, top) {
    const pen = canvas.getContext("2d");
    pen.clearRect(0, 0, this.width, this.height);
    pen.font = `${12 * this.unit}px system-ui, sans-serif`;
    Object.assign(pen, { fillStyle: theme.text, strokeStyle: theme.faint, lineWidth: 1 });
    const rows = Math.max((this.height - TOP - this.bottom) / 36, 1);
    const [dx, dy] = [length * 110 / this.width, top / rows].map((rough) => roundNumber(rough, [1, 2, 5, 10]));
    pen.textAlign = "center";
    for (let s = 0; s <= length; s += dx) pen.fillText(String(Number(s.toPrecision(6))), this.x(s), this.height - this.bottom + 15 * this.unit);
    pen.textAlign = "right";
    for (let r = 0; r <= top; r += dy) {
      pen.fillText(String(Number(r.toPrecision(4))), this.left - 6, this.y(r) + 4);
      stroked(pen, [[this.left, this.y(r)], [this.width - RIGHT, this.y(r)]]);
    }
    pen.fillText("metres driven", this.width - RIGHT, this.height - 4);
    pen.textAlign = "left";
    pen.fillText("drift, rms m", 4, this.height - 4);
    return pen;
  }

  drawLimit(pen, theme, limit) {
    if (limit === null) return;
    Object.assign(pen, { strokeStyle: theme.over, fillStyle: theme.over, lineWidth: 1.5 });
    pen.setLineDash([2, 3]);
    stroked(pen, [[this.left, this.y(limit)], [this.width - RIGHT, this.y(limit)]]);
    pen.setLineDash([]);
    pen.fillText(`limit ${limit} m`, this.left + 6, this.y(limit) - 5);
  }

  drawCursor(pen, theme, drift) {
    const s = this.studio.cursor;
    if (s === null) return;
    const rms = Math.sqrt(Math.max(drift.at(Math.min(s, drift.length)).N, 0)), x = this.x(s);
    Object.assign(pen, { strokeStyle: theme.text, fillStyle: theme.text, lineWidth: 1 });
    stroked(pen, [[x, TOP], [x, this.height - this.bottom]]);
    pen.textAlign = x > this.width - 160 ? "right" : "left";
    pen.fillText(`${metres(rms)} after ${metres(s, 2)}`, x + (pen.textAlign === "left" ? 6 : -6), TOP + 12 * this.unit);
    pen.textAlign = "left";
    this.node.setAttribute("aria-valuemax", drift.length.toFixed(2));
    this.node.setAttribute("aria-valuenow", s.toFixed(2));
    this.node.setAttribute("aria-valuetext", `${metres(rms)} of drift after ${metres(s, 2)}`);
  }

  hover(event) {
    const box = this.node.getBoundingClientRect(), share = (event.clientX - box.left - this.left) / (this.width - this.left - RIGHT);
    this.studio.setCursor(share * this.span);
  }

  key(event) {
    const step = { ArrowRight: 1, ArrowLeft: -1, PageUp: 10, PageDown: -10, Home: -1e9, End: 1e9 }[event.key];
    if (step === undefined) return;
    event.preventDefault();
    this.studio.setCursor((this.studio.cursor ?? 0) + step * this.span / 200);
  }
}
