// The studio: a scene on a page, to be looked at and changed. `mount` is all that others call.
import { Calculator } from "./calculator.js";
import { Chart } from "./chart.js";
import { button, el, metres, roundNumber } from "./dom.js";
import { exceeds } from "./drift.js";
import { asLink, withLink } from "./files.js";
import { MapView } from "./map.js";
import { Panel } from "./panel.js";
import { KIND_NAMES, Session, usualKind } from "./session.js";

const TOOLS = [["select", "v"], ["add", "a"], ["kill", "x"], ["measure", "m"], ["floor", "z"], ["trip", "t"]];
const PANEL_MS = 200;  // numbers that change with every frame cannot be read
const SCALES = [1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10];  // of drift: they hold still while something is dragged
const MOVES = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/** Put a studio into an element.
 *
 * scene: see examples/guide/studio.md. host: null, or what can ask Python: ask(what, question, onProgress, signal) gives
 * the promise of an answer. Returns the Studio, which is also `root.studio`. */
export function mount(root, scene, host = null) {
  root.studio = new Studio(root, withLink(scene, window.location.hash), host);
  return root.studio;
}

class Studio {
  constructor(root, scene, host) {
    Object.assign(this, { root, host, moving: new Set(), telling: null, highlights: [], cursor: null, snap: true });
    Object.assign(this, { session: new Session(scene), calculator: new Calculator(scene) });
    this.kind = scene.beacons[0]?.kind ?? usualKind(KIND_NAMES[0]);
    [this.tools, this.keys] = [new Tools(this), new Keys(this)];
    [this.map, this.chart, this.panel] = [new MapView(this), new Chart(this), new Panel(this)];
    this.status = el("span", { role: "status", "aria-live": "polite" });
    this.meter = el("progress", { max: 1, hidden: true, "aria-label": "lower bound as a share of the best layout" });
    root.classList.add("driftplan-studio");
    root.replaceChildren(this.toolbar(), this.map.node, this.panel.node, this.chart.node,
      el("p", { class: "status" }, this.meter, this.status));
    root.addEventListener("keydown", (event) => this.keys.everywhere(event));
    this.session.listen(() => this.session.scene !== this.shown?.scene && this.highlights.splice(0));
    this.session.listen(() => this.render({ base: ["zones", "sites"].some((one) => this.session.scene[one] !== this.shown?.scene[one]) }));
    new ResizeObserver(() => { this.map.resize(); this.chart.resize(); this.render({ base: true }); }).observe(this.map.node);
    new ResizeObserver(() => root.classList.toggle("narrow", root.clientWidth < 880)).observe(root);  // a notebook's cell is not its window
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.render({ base: true }));
    this.say(scene.notes.join(" "));
  }

  toolbar() {
    const { session, tools } = this;
    tools.buttons = TOOLS.map(([name, key]) => button(`${name} (${key})`, () => tools.choose(name), { "aria-pressed": String(name === "select") }));
    this.estimator = el("select", { onchange: () => session.edit({ estimator: this.estimator.value }) },
      el("option", { value: "reset" }, "reset: readings replace"), el("option", { value: "filter" }, "filter: readings are fused"));
    const kind = el("select", { onchange: () => { this.kind = usualKind(kind.value); } }, KIND_NAMES.map((name) => el("option", { value: name }, name)));
    kind.value = KIND_NAMES.includes(this.kind.name) ? this.kind.name : KIND_NAMES[0];
    const snap = el("input", { type: "checkbox", checked: true, onchange: () => { this.snap = snap.checked; } });
    const asking = this.host ? [button("Fewest", () => this.fewest()), button("Why not?", () => this.fewest("why")), button("Stop", () => this.stopper?.abort())]
      : [el("span", { class: "quiet" }, "Planning and “fewest” need Python: driftplan studio.")];
    if (this.host?.saves) asking.push(button("Save", () => this.ask("save", {}, ({ message }) => this.say(message))));
    return el("header", { class: "toolbar", role: "toolbar", "aria-label": "Tools" }, el("h1", {}, session.scene.title), tools.buttons,
      el("label", {}, "new: ", kind), el("label", {}, snap, "snap to walls"), el("label", {}, "robot: ", this.estimator),
      button("Undo", () => session.undo(), { "aria-keyshortcuts": "Control+Z" }), button("Redo", () => session.redo(), { "aria-keyshortcuts": "Control+Y" }),
      button("+", () => this.map.zoom(1.25), { "aria-label": "zoom in" }), button("−", () => this.map.zoom(0.8), { "aria-label": "zoom out" }),
      button("Whole map (0)", () => this.map.fit()), asking);
  }

  say(text) { this.status.textContent = text; }

  // Computing and drawing, once per frame
  render({ base = false }) {
    this.baseDue ||= base;
    if (this.due) return;
    this.due = true;
    requestAnimationFrame(() => this.frame());
  }

  /** Compute what changed and draw it: what a drag waits for. */
  frame() {
    this.due = false;
    if (!this.map.width) return;
    const { session, calculator } = this, { scene } = session, other = scene.estimator === "reset" ? "filter" : "reset";
    const drifts = scene.routes.map((route) => calculator.drift(scene, route));
    const compared = this.panel.compared.checked, others = scene.routes.map((route) => (compared ? calculator.drift(scene, route, other) : null));
    const [worst, otherWorst] = [drifts, others].map((all) => all.map((drift) => drift?.worst ?? 0));
    const most = roundNumber(Math.max(1e-6, ...worst, ...otherWorst), SCALES);
    if (session.merging === null) this.moving.clear();
    else drifts.forEach((drift, k) => drift !== this.shown?.drifts[k] && this.moving.add(k));
    const stays = scene.routes.map((_, k) => !this.moving.has(k));  // under what an edit of many frames touches
    this.shown = { scene, drifts, others, worst, otherWorst, most, stays };
    if (this.baseDue) this.map.drawBase(scene);
    this.baseDue = false;
    this.map.drawRoutes(this.shown);
    this.map.updateOverlay(this.shown);
    this.chart.draw(this.shown, this.map.theme);
    if (session.merging === null) this.tell();
    else this.telling ??= setTimeout(() => this.tell(), PANEL_MS);
  }

  /** What the panel says: at once, but in the middle of a drag. */
  tell() {
    clearTimeout(this.telling);
    this.telling = null;
    this.panel.update(this.shown);
    this.estimator.value = this.shown.scene.estimator;
  }

  setCursor(s) {
    const drift = this.shown?.drifts[this.session.selected.route];
    const usable = s !== null && Number.isFinite(s) && drift && !(drift instanceof Error);
    this.cursor = usable ? Math.min(Math.max(s, 0), drift.length) : null;
    this.render({});
  }

  /** Say how things stand: to those who look, and to those who listen. */
  announce() {
    this.frame();
    const { scene, worst, drifts } = this.shown, broken = drifts.find((drift) => drift instanceof Error);
    if (broken || !drifts.length) return this.say(broken?.message ?? "");
    const k = worst.indexOf(Math.max(...worst)), exceeding = scene.routes.filter(({ limit_m: limit }, i) => exceeds(worst[i], limit));
    const verdict = exceeding.length ? `${exceeding.length} of ${scene.routes.length} routes exceed their limit.`
      : scene.routes.some(({ limit_m: limit }) => limit !== null) ? "All routes keep their limits." : "";
    const beyond = drifts.some((drift) => drift.beyondLinear) ? " A filter cannot be trusted where the heading is off by more than 9 degrees." : "";
    return this.say(`Greatest drift ${metres(worst[k])}, on ${scene.routes[k].name}. ${verdict}${beyond}`);
  }

  // Edits that buttons and keys share
  /** Turn "locked" or "dead" of a beacon on or off, and show what a death breaks. */
  toggle(k, flag) {
    const { session } = this, { worst: before } = this.shown, { routes } = session.scene;
    session.changeBeacon(k, { [flag]: !session.scene.beacons[k][flag] });
    this.announce();
    if (flag !== "dead" || !session.scene.beacons[k].dead) return;
    const { drifts, worst } = this.shown, broken = [...routes.keys()].filter((r) =>
      exceeds(worst[r], routes[r].limit_m) && !exceeds(before[r], routes[r].limit_m));
    for (const r of broken) this.highlight(drifts[r], drifts[r].above(routes[r].limit_m, drifts[r].length / 400));
    const names = broken.map((r) => routes[r].name).join(", ");
    this.say(`${session.scene.beacons[k].id} is dead. ${broken.length ? `It breaks the limit of ${names}.` : "No further limit breaks."}`);
    this.render({});
  }

  highlight(drift, stretches) {
    for (const [from, to] of stretches) {
      const between = drift.path.legs.filter(({ begin }) => begin > from && begin < to).map(({ x, y }) => [x, y]);
      this.highlights.push([drift.place(from), ...between, drift.place(to)]);
    }
  }

  duplicate(k) {
    const { id: _, ...beacon } = this.session.scene.beacons[k];
    this.session.addBeacon({ ...beacon, x: beacon.x + 0.5, y: beacon.y, existing: false, locked: false });
    this.announce();
  }

  /** What a beacon does, in a sentence. */
  serves(beacon) {
    const routes = this.session.scene.routes.filter((route) => this.calculator.readingsOn(route, beacon).length);
    const names = routes.length > 4 ? `${routes.length} routes` : routes.map(({ name }) => name).join(", ");
    return names ? `Read on ${names}.` : "Within range of no route.";
  }

  link() {
    if (this.root.className.includes("in-notebook")) return this.say("A notebook keeps its state itself: see .beacons.");
    window.location.hash = asLink(this.session.scene);
    navigator.clipboard?.writeText(window.location.href).catch(() => {});
    return this.say("The address of this page now holds the state, and so does the clipboard if the browser allows it.");
  }

  // What Python is asked
  async ask(what, question, then, onProgress = () => {}) {
    if (!this.host) return this.say("This page is a file: it cannot ask Python. Run “driftplan studio” for plans and the fewest beacons.");
    this.stopper?.abort();
    const stopper = this.stopper = new AbortController();
    [this.meter.hidden, this.meter.value] = [false, 0];
    try {
      then(await this.host.ask(what, { scene: this.session.scene, ...question }, onProgress, stopper.signal));
    } catch (error) {
      this.say(stopper.signal.aborted ? "Stopped." : error.message);
    }
    this.meter.hidden = stopper === this.stopper;
    return null;
  }

  /** Ask for the fewest beacons, or only why the limits cannot be kept. */
  fewest(what = "fewest") {
    this.say("Looking for beacons that keep the limits …");
    const began = performance.now(), seconds = () => ((performance.now() - began) / 1000).toFixed(0);
    return this.ask(what, { kind: this.session.beacon?.kind ?? this.kind }, (answer) => {
      if (answer.infeasible) this.showInfeasible(answer);
      else if (what === "why") this.say(answer.message);
      else {
        this.session.selected.beacon = null;
        this.session.edit({ beacons: answer.beacons });
        this.say(`${answer.proven ? "★ Proven fewest" : "Best found, not proven"}: ${answer.message}`);
      }
    }, ({ cost, bound }) => {
      this.meter.value = cost ? bound / cost : 0;  // full when the bound has met the best layout
      this.say(`${seconds()} s: best layout ${cost ?? "none yet"}, at least ${bound} needed.`);
    });
  }

  showInfeasible({ infeasible, route, from_m: from, to_m: to }) {
    this.say(`Infeasible: ${infeasible}`);
    const drift = this.shown.drifts[route];
    if (!drift || drift instanceof Error) return;
    this.session.select({ route });
    this.highlight(drift, [[from, to]]);
  }

  plan(start, goal) {
    this.say("Planning, for five seconds at most …");
    const { session } = this, limit = session.route?.limit_m ?? null;
    let found = [];
    const show = ({ routes }) => {  // a first answer at once, and a better one in its place: one step of the history
      const others = session.scene.routes.filter((route) => !found.includes(route));
      found = routes.map(({ name, points }) => ({ name, points, limit_m: limit }));
      session.selected.route = others.length;
      session.edit({ routes: [...others, ...found] }, "plan");
      this.say(routes.map(({ name, rms_m: rms, length_m: length }) => `${name}: ${metres(rms)} of drift at the goal, ${metres(length, 1)} long`).join("; "));
    };
    return this.ask("plan", { start, goal }, (answer) => { show(answer); session.settle(); }, show);
  }
}

/** Tools that act at a place, or from one place to another. */
class Tools {
  constructor(studio) { Object.assign(this, { studio, tool: "select", drag: null }); }

  choose(name) {
    this.tool = name;
    this.drag = null;
    this.buttons.forEach((button, k) => button.setAttribute("aria-pressed", TOOLS[k][0] === name));
    this.studio.map.node.dataset.tool = name;
    this.studio.render({});
  }

  press(xy) {
    const { studio } = this, { kind } = studio;
    if (this.tool === "add") {
      studio.session.addBeacon({ x: xy[0], y: xy[1], kind, facing_deg: (kind.view_angle_deg ?? 360) < 360 ? 0 : null });
      studio.announce();
    } else this.drag = { tool: this.tool === "floor" ? "zone" : this.tool, from: xy, to: xy };
    studio.render({});
  }

  move(xy) {
    if (this.drag) this.drag.to = xy;
    this.studio.render({});
  }

  release(xy) {
    const { drag, studio } = this;
    if (!drag) return;
    drag.to = xy;
    const size = Math.hypot(xy[0] - drag.from[0], xy[1] - drag.from[1]);
    if (drag.tool === "measure") studio.say(`${metres(size)} from (${drag.from.map((c) => c.toFixed(2))}) to (${xy.map((c) => c.toFixed(2))})`);
    else this.drag = null;
    if (drag.tool === "zone" && size > 0) studio.session.addZone(drag.from, xy, 3);
    if (drag.tool === "trip" && size > 0) studio.plan(drag.from, xy);
    studio.render({});
  }
}

/** What keys do. */
class Keys {
  constructor(studio) { this.studio = studio; }

  everywhere(event) {
    const { studio } = this, typing = event.target.closest("input, select, textarea"), key = event.key.toLowerCase();
    if ((event.ctrlKey || event.metaKey) && !typing && (key === "z" || key === "y")) {
      event.preventDefault();
      if (key === "y" || event.shiftKey) studio.session.redo();
      else studio.session.undo();
    } else if (!typing && !event.ctrlKey && !event.metaKey && !event.defaultPrevented) {
      const { map, tools } = studio, tool = TOOLS.find(([, letter]) => letter === key);
      const acts = { "+": () => map.zoom(1.25), "=": () => map.zoom(1.25), "-": () => map.zoom(0.8), 0: () => map.fit(), escape: () => tools.choose("select") };
      (tool ? () => tools.choose(tool[0]) : acts[key])?.();
    }
  }

  beacon(event, k) {
    const { studio } = this, { session } = studio, beacon = session.scene.beacons[k], { x, y, facing_deg: facing, locked } = beacon;
    this.act(event, { delete: () => session.remove("beacons", k), d: () => studio.duplicate(k), l: () => studio.toggle(k, "locked"),
      k: () => studio.toggle(k, "dead"), r: () => session.changeBeacon(k, { facing_deg: (facing ?? 0) + (event.shiftKey ? -15 : 15) }) },
    ([dx, dy]) => locked || session.changeBeacon(k, { x: x + dx, y: y + dy }, `keys ${k}`));
  }

  waypoint(event, k) {
    const { session } = this.studio, [x, y] = session.route.points[k], insert = () => session.insertWaypoint(k);
    this.act(event, { delete: () => session.removeWaypoint(k), insert, i: insert },
      ([dx, dy]) => session.moveWaypoint(k, [x + dx, y + dy], `keys waypoint ${k}`));
  }

  /** What is said of a key, or a move by arrow keys: 0.1 m, with Shift 1 m. */
  act(event, acts, go) {
    const move = MOVES[event.key]?.map((c) => c * (event.shiftKey ? 1 : 0.1)), name = event.key.toLowerCase();
    const act = move ? () => go(move) : acts[name === "backspace" ? "delete" : name];
    if (event.ctrlKey || event.metaKey || !act) return;
    event.preventDefault();
    act();
    if (name !== "k") this.studio.announce();  // a death has said what it breaks
  }

  /** The cross of those who have no mouse. */
  map(event) {
    const { map, tools } = this.studio, move = MOVES[event.key];
    if (move) {
      const step = (event.shiftKey ? 50 : 5) / map.scale;
      map.cross = (map.cross ?? map.centre).map((c, k) => c + move[k] * step);
      const [x, y] = map.toScreen(map.cross), beyond = (at, size) => Math.min(Math.max(at, 0), size) - at;
      map.pan(beyond(x, map.width), beyond(y, map.height));  // the map follows
      if (tools.drag) tools.move(map.snapped(map.cross));
    } else if (event.key === "Enter" && map.cross && !["select", "kill"].includes(tools.tool)) {
      const xy = map.snapped(map.cross);
      if (tools.drag && tools.tool !== "add") tools.release(xy);
      else tools.press(xy);
    } else return;
    event.preventDefault();
    this.studio.render({});
  }
}
