// The map: walls and floors on one canvas, routes that stay on a second, those that change on a third, and what can be
// grasped as SVG above them.
import { same } from "./calculator.js";
import { CLASSES, classOf, symbolOf, themeOf } from "./colours.js";
import { CURVE_PIXELS, el, metres, resized, roundNumber, stroked, svg } from "./dom.js";

const ELLIPSE_PIXELS = 90;  // between error ellipses
const SNAP_PIXELS = 14;

export class MapView {
  constructor(studio) {
    Object.assign(this, { studio, beacons: [], cross: null, grips: svg("g"), drawing: svg("g") });
    [this.base, this.still, this.live] = Array.from({ length: 3 }, () => el("canvas", { "aria-hidden": "true" }));
    this.overlay = svg("svg", { tabindex: "0", role: "application", class: "map-overlay",
      "aria-label": "Map. Arrow keys move the cross, Enter acts there, Tab goes to the beacons." },
    this.drawing, this.grips);
    this.node = el("div", { class: "map" }, this.base, this.still, this.live, this.overlay);
    this.listen();
  }

  /** Show the whole map. */
  fit() {
    const [left, low, right, high] = this.studio.session.scene.bounds;
    this.centre = [(left + right) / 2, (low + high) / 2];
    this.scale = 0.9 * Math.min(this.width / Math.max(right - left, 1e-3), this.height / Math.max(high - low, 1e-3));
    this.studio.render({ base: true });
  }

  resize() {
    const first = !this.width;
    resized(this, this.base, this.still, this.live);
    if (!this.width) return;
    this.overlay.setAttribute("viewBox", `0 0 ${this.width} ${this.height}`);
    if (first) this.fit();
  }

  toScreen([x, y]) { return [(x - this.centre[0]) * this.scale + this.width / 2, (this.centre[1] - y) * this.scale + this.height / 2]; }
  toWorld([px, py]) { return [(px - this.width / 2) / this.scale + this.centre[0], (this.height / 2 - py) / this.scale + this.centre[1]]; }

  zoom(factor, at = [this.width / 2, this.height / 2]) {
    const before = this.toWorld(at);
    this.scale = Math.min(Math.max(this.scale * factor, 0.05), 5000);
    const after = this.toWorld(at);
    this.centre = this.centre.map((c, k) => c + before[k] - after[k]);
    this.studio.render({ base: true });
  }

  pan(dx, dy) {
    this.centre = [this.centre[0] - dx / this.scale, this.centre[1] + dy / this.scale];
    this.studio.render({ base: true });
  }

  // Drawing
  drawBase(scene) {
    const pen = this.base.getContext("2d"), theme = this.theme = themeOf(this.node);
    pen.clearRect(0, 0, this.width, this.height);
    const shape = (polygons) => new Path2D(polygons.flat().map((ring) => `M${ring.map((xy) => this.toScreen(xy)).join("L")}Z`).join(""));
    Object.assign(pen, { fillStyle: theme.zone, strokeStyle: theme.zoneLine, lineWidth: 1 }).setLineDash([6, 4]);
    for (const path of scene.zones.map(({ polygons }) => shape(polygons))) {
      pen.fill(path, "evenodd");
      pen.stroke(path);
    }
    pen.setLineDash([]);
    pen.fillStyle = theme.route;
    for (const [x, y] of scene.sites.map((site) => this.toScreen([site.x, site.y]))) pen.fillRect(x - 2, y - 2, 4, 4);
    pen.fillStyle = theme.wall;
    pen.fill(shape(scene.walls), "evenodd");
    const [left, low, right, high] = scene.bounds, [x, y] = this.toScreen([left, high]);
    Object.assign(pen, { strokeStyle: theme.faint, lineWidth: 1 });
    pen.strokeRect(x, y, (right - left) * this.scale, (high - low) * this.scale);
    this.drawScaleBar(pen, theme);
  }

  drawScaleBar(pen, theme) {
    const wanted = 120 / this.scale, size = roundNumber(wanted, [5, 2, 1], (step) => step <= wanted), x = 12, y = this.height - 12;
    const bar = new Path2D(`M${x} ${y - 5}V${y}H${x + size * this.scale}V${y - 5}`);
    for (const [strokeStyle, lineWidth] of [[theme.paper, 5], [theme.text, 2]]) Object.assign(pen, { strokeStyle, lineWidth }).stroke(bar);
    this.write(pen, `${size} m`, x + 4, y - 8);
  }

  /** Letters with a halo, on whatever is below. */
  write(pen, text, x, y) {
    pen.save();
    Object.assign(pen, { font: `${12 * this.unit}px system-ui, sans-serif`, fillStyle: this.theme.text, strokeStyle: this.theme.paper, lineWidth: 5 });
    pen.strokeText(text, x, y);
    pen.fillText(text, x, y);
    pen.restore();
  }

  /** The routes that stay, where they are not drawn yet; above them those that change, highlights and the cursor. */
  drawRoutes(shown) {
    const { scene, drifts, most, stays } = shown, { selected } = this.studio.session, all = [...scene.routes.keys()];
    const still = all.filter((k) => stays[k]), route = scene.routes[selected.route], drift = drifts[selected.route];
    const state = [this.theme, this.scale, ...this.centre, most, route, ...still.flatMap((k) => [scene.routes[k], drifts[k]])];
    if (!same(state, this.drawnStill)) this.drawSome(this.cleared(this.still), still, shown);
    this.drawnStill = state;
    const pen = this.cleared(this.live);
    this.drawSome(pen, all.filter((k) => !stays[k]), shown);
    pen.globalAlpha = 0.45;
    for (const points of this.studio.highlights) this.strokeLine(pen, points, this.theme.over, 12 * this.unit);
    pen.globalAlpha = 1;
    if (this.studio.cursor !== null && route && !(drift instanceof Error)) this.drawCursor(pen, drift);
    if (this.studio.session.beacon) this.drawRange(pen, this.studio.session.beacon);
    this.drawCross(pen);
  }

  cleared(canvas) {
    const pen = canvas.getContext("2d");
    pen.clearRect(0, 0, this.width, this.height);
    return pen;
  }

  /** Some of the routes, the selected one on top. */
  drawSome(pen, which, { scene, drifts, most }) {
    const chosen = this.studio.session.selected.route, others = which.filter((k) => k !== chosen);
    const draw = (k, width) => {
      const { points, limit_m: limit } = scene.routes[k];
      if (drifts[k] instanceof Error) this.strokeLine(pen, points, this.theme.route, 1.5);
      else this.strokeDrift(pen, drifts[k], limit, most, width);
    };
    Object.assign(pen, { lineCap: "butt", lineJoin: "bevel" });  // thin lines: round ones take longer to draw
    for (const k of others) draw(k, 2.5);
    for (const k of others) this.drawArrow(pen, scene.routes[k], false);
    pen.lineCap = pen.lineJoin = "round";
    if (others.length === which.length) return;
    this.strokeLine(pen, scene.routes[chosen].points, this.theme.paper, 9 * this.unit);
    draw(chosen, 5);
    if (!(drifts[chosen] instanceof Error)) this.drawEllipses(pen, drifts[chosen]);
    this.drawArrow(pen, scene.routes[chosen], true);
  }

  strokeLine(pen, points, colour, width) {
    Object.assign(pen, { strokeStyle: colour, lineWidth: width });
    stroked(pen, points.map((xy) => this.toScreen(xy)));
  }

  /** A route in the colours of its drift. What is drawn is kept with the drift, in metres. */
  strokeDrift(pen, drift, limit, most, width) {
    const spacing = Math.max(CURVE_PIXELS / this.scale, drift.length / 2000), key = `${spacing} ${limit ?? most}`;
    if (drift.drawn?.key !== key) drift.drawn = { key, pieces: this.piecesOf(drift, spacing, limit, most) };
    const [x, y] = this.toScreen([0, 0]);
    pen.save();
    pen.transform(this.scale, 0, 0, -this.scale, x, y);
    drift.drawn.pieces.forEach((piece, k) => {
      pen.strokeStyle = k < CLASSES ? this.theme.ramp[k] : this.theme.over;
      pen.lineWidth = (k < CLASSES ? width : width * 1.6) * this.unit / this.scale;
      pen.stroke(piece);
    });
    pen.restore();
  }

  piecesOf(drift, spacing, limit, most) {
    const { legs } = drift.path, pieces = [];
    let k = 0, leg = 0, before = [legs[0].x, legs[0].y], last = null;
    for (const [s, rms] of drift.curve(spacing)) {
      while (k + 1 < legs.length && legs[k].begin + legs[k].length < s - 1e-9) k++;
      const now = classOf(rms, limit, most), { x, y, ux, uy, begin } = legs[k];
      if (now !== last || k !== leg) {  // a line ends only at corners, and where the colour changes
        pieces[last]?.lineTo(...before);
        if (now !== last) (pieces[now] ??= new Path2D()).moveTo(...before);
        [last, leg] = [now, k];
      }
      before = [x + ux * (s - begin), y + uy * (s - begin)];
    }
    pieces[last].lineTo(...before);
    return pieces;
  }

  /** Where the estimate is with 86 % (two standard deviations in every direction), about the true place. */
  drawEllipses(pen, drift) {
    Object.assign(pen, { strokeStyle: this.theme.text, lineWidth: 1 });
    const count = Math.max(1, Math.min(60, Math.round(drift.length * this.scale / ELLIPSE_PIXELS)));
    for (let i = 1; i <= count; i++) {
      const s = drift.length * i / count, { N, e1, e2 } = drift.at(s), [x, y] = drift.place(s);
      const cr = e2[0] - e1[0] ** 2 + e1[1] ** 2, ci = e2[1] - 2 * e1[0] * e1[1], trace = N - e1[0] ** 2 - e1[1] ** 2;
      const spread = Math.hypot(cr, ci), radii = [trace + spread, trace - spread].map((v) => 2 * Math.sqrt(Math.max(v / 2, 0)));
      const [px, py] = this.toScreen([x + e1[0], y + e1[1]]);
      pen.beginPath();
      pen.ellipse(px, py, radii[0] * this.scale, radii[1] * this.scale, -Math.atan2(ci, cr) / 2, 0, 2 * Math.PI);
      pen.stroke();
    }
  }

  /** Which way a route goes: an arrow head half-way along its longest leg. */
  drawArrow(pen, route, strong) {
    const { legs } = this.studio.calculator.pathOf(route);
    const leg = legs.reduce((best, one) => (one.length > best.length ? one : best));
    if (leg.length * this.scale < 24) return;
    const [x, y] = this.toScreen([leg.x + leg.ux * leg.length * 0.5, leg.y + leg.uy * leg.length * 0.5]);
    const size = (strong ? 9 : 6) * this.unit;
    pen.fillStyle = strong ? this.theme.text : this.theme.route;
    pen.beginPath();
    for (const angle of [0, 2.5, -2.5].map((turn) => leg.angle + turn)) pen.lineTo(x + size * Math.cos(angle), y - size * Math.sin(angle));
    pen.fill();
  }

  drawCursor(pen, drift) {
    const [px, py] = this.toScreen(drift.place(this.studio.cursor));
    Object.assign(pen, { strokeStyle: this.theme.text, lineWidth: 2 });
    pen.beginPath();
    pen.arc(px, py, 8, 0, 2 * Math.PI);
    pen.stroke();
  }

  /** From where a beacon is read. */
  drawRange(pen, { x, y, kind, facing_deg: facing }) {
    const [px, py] = this.toScreen([x, y]), view = kind.view_angle_deg ?? 360;
    const [from, to] = [view, -view].map((turn) => -((facing ?? 0) + turn / 2) * Math.PI / 180);
    Object.assign(pen, { fillStyle: this.theme.accent, strokeStyle: this.theme.accent, lineWidth: 1, globalAlpha: 0.1 });
    pen.beginPath();
    if (view < 360) pen.moveTo(px, py);
    pen.arc(px, py, kind.range_m * this.scale, from, to);
    pen.closePath();
    pen.fill();
    pen.globalAlpha = 1;
    pen.stroke();
  }

  /** The cross that keys move, and what a tool is drawing. */
  drawCross(pen) {
    const { drag } = this.studio.tools, line = new Path2D(), [x, y] = this.cross ? this.toScreen(this.cross) : [];
    Object.assign(pen, { strokeStyle: this.theme.accent, lineWidth: 2 * this.unit });
    if (this.cross) line.addPath(new Path2D(`M${x - 12} ${y}H${x + 12}M${x} ${y - 12}V${y + 12}`));
    if (drag) {
      const [[x0, y0], [x1, y1]] = [drag.from, drag.to].map((xy) => this.toScreen(xy));
      line.addPath(new Path2D(drag.tool === "zone" ? `M${x0} ${y0}H${x1}V${y1}H${x0}Z` : `M${x0} ${y0}L${x1} ${y1}`));
      this.write(pen, metres(Math.hypot(drag.to[0] - drag.from[0], drag.to[1] - drag.from[1]), 2), x1 + 10, y1 - 8);
    }
    pen.stroke(line);
  }

  // What can be grasped
  updateOverlay({ scene }) {
    const { session } = this.studio, { selected } = session, view = [this.scale, this.centre, this.width, this.height].join();
    while (this.beacons.length > scene.beacons.length) this.beacons.pop().node.remove();
    scene.beacons.forEach((beacon, k) => {
      const grip = this.beacons[k] ?? (this.beacons[k] = this.newGrip(k));
      const isSelected = k === selected.beacon;
      if (grip.beacon !== beacon || grip.view !== view || grip.isSelected !== isSelected) this.place(grip, beacon, isSelected);
      Object.assign(grip, { beacon, view, isSelected });
    });
    this.updateWaypoints(session.route, selected.waypoint, view);
  }

  newGrip(k) {
    const shape = svg("path", { class: "symbol" }), mark = svg("path", { class: "mark" }), label = svg("text", { x: 10, y: 4 });
    const node = svg("g", { class: "beacon", tabindex: "0", role: "button", "data-beacon": k,
      onfocus: () => this.studio.session.selected.beacon !== k && this.studio.session.select({ beacon: k, waypoint: null }),
      onkeydown: (event) => this.studio.keys.beacon(event, k) }, shape, mark, label);
    this.grips.append(node);
    return { node, shape, mark, label };
  }

  place({ node, shape, mark, label }, beacon, isSelected) {
    const [x, y] = this.toScreen([beacon.x, beacon.y]), { kind, locked, dead } = beacon;
    node.setAttribute("transform", `translate(${x} ${y}) scale(${this.unit})`);
    node.setAttribute("class", `beacon${dead ? " dead" : ""}${isSelected ? " selected" : ""}${locked ? " locked" : ""}`);
    const states = [locked && "locked", dead && "dead"].filter(Boolean).map((word) => `, ${word}`).join("");
    node.setAttribute("aria-label", `beacon ${beacon.id}, ${kind.name}, at ${beacon.x.toFixed(2)}, ${beacon.y.toFixed(2)} m${states}`);
    node.setAttribute("aria-pressed", isSelected);
    shape.setAttribute("d", symbolOf(kind));
    const faces = (beacon.facing_deg ?? null) !== null && (kind.view_angle_deg ?? 360) < 360;
    const turn = -(beacon.facing_deg ?? 0) * Math.PI / 180;
    mark.setAttribute("d", (dead ? "M-8-8L8 8M8-8L-8 8" : "") + (locked ? "M-10-10H10V10H-10Z" : "")
      + (faces ? `M0 0L${16 * Math.cos(turn)} ${16 * Math.sin(turn)}` : ""));
    label.textContent = isSelected || this.beacons.length <= 40 ? beacon.id : "";
  }

  updateWaypoints(route, chosen, view) {
    const state = `${view} ${chosen}`;
    if (this.shownRoute === route && this.shownState === state) return;
    const focused = document.activeElement?.getAttribute("data-waypoint");
    [this.shownRoute, this.shownState] = [route, state];
    const nodes = (route?.points ?? []).map((xy, k) => {
      const [x, y] = this.toScreen(xy);
      return svg("rect", { class: `waypoint${k === chosen ? " selected" : ""}`, x: x - 5 * this.unit, y: y - 5 * this.unit,
        width: 10 * this.unit, height: 10 * this.unit,
        tabindex: "0", role: "button", "data-waypoint": k,
        "aria-label": `waypoint ${k + 1} of ${route.points.length}, at ${xy[0].toFixed(2)}, ${xy[1].toFixed(2)} m`,
        onfocus: () => this.studio.session.selected.waypoint !== k && this.studio.session.select({ waypoint: k, beacon: null }),
        onkeydown: (event) => this.studio.keys.waypoint(event, k) });
    });
    this.drawing.replaceChildren(...nodes);
    if (focused !== null && focused !== undefined) nodes[focused]?.focus();
  }

  // Mouse, pen and touch
  at(event) {
    const box = this.overlay.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  /** A place of the map, on the nearest wall if it is near and snapping is on. */
  snapped(xy) {
    if (!this.studio.snap) return xy;
    const { walls } = this.studio.calculator, near = walls.nearest(...xy, SNAP_PIXELS / this.scale);
    if (!near) return xy;
    const [nx, ny] = near, off = Math.hypot(xy[0] - nx, xy[1] - ny), out = walls.inside(...xy) ? -1 : 1;
    return off > 0 ? near.map((c, k) => c + out * 2e-6 * (xy[k] - c) / off) : near;  // on it, not in it: it has to be seen
  }

  listen() {
    const fingers = new Map();
    let grasp = null;
    const pinch = () => {  // how far two fingers are apart, and where the middle is
      const [p, q] = [...fingers.values()];
      return q && [Math.hypot(p[0] - q[0], p[1] - q[1]), [(p[0] + q[0]) / 2, (p[1] + q[1]) / 2]];
    };
    this.overlay.addEventListener("pointerdown", (event) => {
      const { session, tools } = this.studio, screen = this.at(event), world = this.toWorld(screen);
      fingers.set(event.pointerId, screen);
      const grip = event.target.closest("[data-beacon], [data-waypoint]"), { beacon, waypoint } = grip?.dataset ?? {};
      this.overlay.setPointerCapture(event.pointerId);
      this.overlay.focus({ preventScroll: true });
      if (event.button === 1 || event.altKey || (tools.tool === "select" && !grip)) grasp = { pan: screen };
      else if (tools.tool === "kill") beacon && this.studio.toggle(Number(beacon), "dead");
      else if (tools.tool === "select") {
        const held = session.scene.beacons[beacon];
        grip.focus();
        session.select({ beacon: held ? Number(beacon) : null, waypoint: held ? null : Number(waypoint) });
        grasp = held ? { beacon: Number(beacon), off: [held.x - world[0], held.y - world[1]] } : { waypoint: Number(waypoint) };
      } else {
        grasp = { tool: true };
        tools.press(this.snapped(world));
      }
      event.preventDefault();
    });
    this.overlay.addEventListener("pointermove", (event) => {
      if (!grasp) return;
      const { session, tools } = this.studio, screen = this.at(event), world = this.toWorld(screen);
      const before = pinch();
      fingers.set(event.pointerId, screen);
      if (before) this.zoom(pinch()[0] / Math.max(before[0], 1), before[1]);
      else if (grasp.pan) {
        this.pan(screen[0] - grasp.pan[0], screen[1] - grasp.pan[1]);
        grasp.pan = screen;
      } else if (grasp.beacon !== undefined) {
        const held = session.scene.beacons[grasp.beacon];
        if (!held || held.locked) return;
        const [x, y] = this.snapped(world.map((c, k) => c + grasp.off[k]));
        session.changeBeacon(grasp.beacon, { x, y }, "drag");
      } else if (grasp.waypoint !== undefined) session.moveWaypoint(grasp.waypoint, world, "drag");
      else tools.move(this.snapped(world));
    });
    const release = (event) => {
      fingers.delete(event.pointerId);
      if (grasp?.tool) this.studio.tools.release(this.snapped(this.toWorld(this.at(event))));
      if (grasp && !grasp.pan) this.studio.announce();
      this.studio.session.settle();
      grasp = null;
    };
    for (const end of ["pointerup", "pointercancel"]) this.overlay.addEventListener(end, release);
    this.overlay.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0015), this.at(event));
    }, { passive: false });
    this.overlay.addEventListener("keydown", (event) => event.target === this.overlay && this.studio.keys.map(event));
  }
}
