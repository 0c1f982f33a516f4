// The side of the page: the selected beacon, the routes and their verdicts, the odometry, floors, and files.
import { button, el, save } from "./dom.js";
import { exceeds } from "./drift.js";
import { beaconsFromGeojson, noiseFromYaml, routeFromCsv, zonesFromGeojson } from "./files.js";
import { DRAWN, WRITTEN } from "./handover.js";
import { KIND_NAMES, usualKind, worse } from "./session.js";

const DEG = Math.PI / 180;
const FIELDS = [  // of the selected beacon: label, where the value is, its unit in the scene's, bounds if not 0 to 1e6
  ["x, m", "x", 1, -1e9, 1e9], ["y, m", "y", 1, -1e9, 1e9], ["faces, deg", "facing_deg", 1, -1e6], ["range, m", "kind.range_m", 1, 1e-6],
  ["position std, m", "kind.position_std_m", 1], ["heading std, deg", "kind.heading_std", DEG],
  ["distance std, m", "kind.range_std_m", 1], ["bearing std, deg", "kind.bearing_std", DEG], ["loses, m per m", "kind.std_per_m", 1],
  ["read with chance", "kind.detection_probability", 1, 1e-6, 1], ["seen from within, deg", "kind.view_angle_deg", 1, 1e-6, 360],
  ["sensor sees, deg", "kind.sensor_view_deg", 1, 1e-6, 360], ["costs", "kind.cost", 1, 1e-6],
];
const SLIDERS = [  // standard deviations a person can measure: label, rate, after how much of what, unit
  ["heading, deg after 10 m", "heading_var_per_m", 10, DEG, 20],
  ["distance, m after 10 m", "distance_var_per_m", 10, 1, 1],
  ["heading, deg per full turn", "heading_var_per_rad", 2 * Math.PI, DEG, 20],
];

export class Panel {
  constructor(studio) {
    Object.assign(this, { studio, session: studio.session });
    this.node = el("aside", { class: "panel", "aria-label": "Details" }, this.beaconSection(), this.routeSection(),
      this.noiseSection(), this.zoneSection(), this.fileSection());
  }

  section(title, ...children) { return el("details", { open: true }, el("summary", {}, title), ...children); }

  beaconSection() {
    const { session } = this, selected = () => session.selected.beacon;
    this.id = el("input", { type: "text", onchange: () => session.changeBeacon(selected(), { id: this.id.value }) });
    this.kind = el("select", { onchange: () => session.changeBeacon(selected(), { kind: usualKind(this.kind.value) }) },
      KIND_NAMES.map((name) => el("option", { value: name }, name)));
    this.fields = FIELDS.map(([label, where, unit, ...bounds]) => {
      const input = el("input", { type: "number", step: "any", onchange: () => this.changeField(where, unit, input, ...bounds) });
      return { input, where, unit, row: el("label", {}, label, input) };
    });
    this.seen = el("input", { type: "checkbox",
      onchange: () => session.changeBeacon(selected(), { kind: { ...session.beacon.kind, line_of_sight: this.seen.checked } }) });
    const act = (text, key, action) => button(text, () => session.beacon && action(selected()), { "aria-keyshortcuts": key });
    this.said = el("p", { class: "quiet" });
    this.form = el("div", { class: "fields" }, el("label", {}, "id", this.id), el("label", {}, "kind", this.kind),
      this.fields.map(({ row }) => row), el("label", {}, "walls block it", this.seen));
    return this.section("Beacon", this.said, this.form, el("div", { class: "row" },
      act("Lock", "l", (k) => this.studio.toggle(k, "locked")), act("Kill", "k", (k) => this.studio.toggle(k, "dead")),
      act("Duplicate", "d", (k) => this.studio.duplicate(k)), act("Delete", "Delete", (k) => session.remove("beacons", k))));
  }

  changeField(where, unit, input, low = 0, high = 1e6) {
    const { session } = this, value = Number(input.value) * unit;
    const empty = input.value === "" && where === "facing_deg";
    if (!empty && (input.value === "" || !(value >= low && value <= high))) {
      this.studio.say(`expected a number from ${low} to ${high}, got “${input.value}”`);
      this.beaconShown = null;
      return this.update(this.studio.shown);
    }
    const needsFacing = where === "kind.view_angle_deg" && value < 360 && session.beacon.facing_deg === null;
    const own = needsFacing ? { facing_deg: 0 } : {};
    if (where.startsWith("kind.")) own.kind = { ...session.beacon.kind, [where.slice(5)]: value };
    else own[where] = empty && (session.beacon.kind.view_angle_deg ?? 360) === 360 ? null : value;
    return session.changeBeacon(session.selected.beacon, own);
  }

  routeSection() {
    const { session } = this;
    this.rows = el("tbody");
    this.compared = el("input", { type: "checkbox", onchange: () => this.studio.render({}) });
    const heads = ["route", "length, m", "drift, m", "other robot", "limit, m", ""].map((head) => el("th", { scope: "col" }, head));
    this.limit = el("input", { type: "number", step: "any", min: "0", "aria-label": "limit for all routes, metres",
      onchange: () => this.setLimit(session.scene.routes.map((_, k) => k), this.limit.value) });
    this.table = el("table", {}, el("thead", {}, el("tr", {}, heads)), this.rows);
    this.trouble = el("p", { class: "quiet" });
    return this.section("Routes", this.table, this.trouble, el("div", { class: "row" }, el("label", {}, "limit of all, m", this.limit),
      el("label", {}, this.compared, "compare both estimators"),
      button("Insert waypoint", () => session.route && session.insertWaypoint(session.selected.waypoint ?? 0)),
      button("Remove waypoint", () => session.selected.waypoint !== null && session.removeWaypoint(session.selected.waypoint))));
  }

  setLimit(routes, text) {
    const value = text === "" ? null : Number(text), { session } = this;
    if (value !== null && !(value > 0)) return this.studio.say("expected a limit above 0 m");
    return session.edit({ routes: session.scene.routes.map((route, k) => (routes.includes(k) ? { ...route, limit_m: value } : route)) });
  }

  rowOf(k) {
    const { session } = this, cells = Array.from({ length: 6 }, () => el("td"));
    const pick = el("input", { type: "radio", name: "route", onchange: () => session.select({ route: k, waypoint: null }) });
    const name = el("span"), limit = el("input", { type: "number", step: "any", min: "0", onchange: () => this.setLimit([k], limit.value) });
    cells[0].append(el("label", {}, pick, name));
    cells[4].append(limit);
    const node = el("tr", {}, cells);
    this.rows.append(node);
    return { node, cells, pick, name, limit };
  }

  noiseSection() {
    const { session } = this;
    this.sliders = SLIDERS.map(([label, rate, after, unit, most]) => {
      const value = el("output"), input = el("input", { type: "range", min: "0", max: "1", step: "0.002", "aria-label": label,
        oninput: () => {
          const std = most * input.valueAsNumber ** 2 * unit;
          session.edit({ noise: { ...session.scene.noise, [rate]: std * std / after } }, `noise ${rate}`);
        }, onchange: () => session.settle() });
      return { input, value, rate, after, unit, most, row: el("label", {}, label, input, value) };
    });
    this.more = el("p", { class: "quiet" });
    return this.section("Odometry", el("div", { class: "fields" }, this.sliders.map(({ row }) => row)), this.more);
  }

  zoneSection() {
    this.zones = el("div", { class: "fields" });
    return this.section("Floors", this.zones, el("p", { class: "quiet" }, "Paint a floor with the tool “floor” (z)."));
  }

  fileSection() {
    const { session, studio } = this;
    const open = el("input", { type: "file", onchange: async () => {
      const [file] = open.files;
      if (file) this.load(file.name, await file.text());
      open.value = "";
    } });
    const names = [...Object.keys(WRITTEN), ...(studio.host ? DRAWN : [])];
    const file = el("select", { "aria-label": "file to write" }, names.map((name) => el("option", { value: name }, name)));
    const write = () => (WRITTEN[file.value] ? save(file.value, this.written(file.value))
      : studio.ask("write", { name: file.value }, ({ bytes }) => save(file.value, Uint8Array.from(bytes, (char) => char.charCodeAt(0)))));
    this.asSites = el("input", { type: "checkbox" });
    return this.section("Files", el("div", { class: "row" }, file, button("Write", write), button("Link to this state", () => studio.link())),
      el("label", {}, "Open beacons, floors, noise or a route ", open), el("div", { class: "row" },
        el("label", {}, this.asSites, "as candidate sites"), button("Forget sites", () => session.edit({ sites: [] }))), studio.host ? null
        : el("p", { class: "quiet" }, "Drawings and files of other programs need Python: driftplan studio."));
  }

  /** The text of a file that `driftplan place` writes or reads. */
  written(name) { return WRITTEN[name](this.studio); }

  /** Take over a file that `driftplan place` reads or writes, by its name; Python reads what the page cannot. */
  load(name, text) {
    const { session, studio } = this, { scene, selected } = session, limit = session.route?.limit_m ?? null;
    const take = (found) => {
      Object.assign(selected, { beacon: null, waypoint: null, route: found.routes ? found.routes.length - 1 : selected.route });
      session.edit(found);
      studio.say(`read ${name}`);
    };
    try {
      const isJson = /\.(geo)?json$/i.test(name), zones = isJson ? zonesFromGeojson(text) : [];
      if (this.asSites.checked) take({ sites: isJson ? beaconsFromGeojson(text) : routeFromCsv(text, 1).map(([x, y]) => ({ x, y })) });
      else if (zones.length) take({ zones });
      else if (isJson) take({ beacons: beaconsFromGeojson(text) });
      else if (/\.ya?ml$/i.test(name)) take({ noise: noiseFromYaml(text) });
      else take({ routes: [...scene.routes, { name, points: routeFromCsv(text), limit_m: limit }] });
    } catch (error) {
      return studio.host ? studio.ask("read", { name, text, kind: studio.kind }, take) : studio.say(`${name}: ${error.message}`);
    }
    return null;
  }

  update(shown) {
    this.updateBeacon(shown);
    this.updateRoutes(shown);
    const { scene } = shown;
    for (const { input, value, rate, after, unit, most } of this.sliders) {
      const std = Math.sqrt((scene.noise[rate] ?? 0) * after) / unit;
      if (document.activeElement !== input) input.value = Math.sqrt(std / most);
      value.textContent = std.toPrecision(3);
    }
    const others = Object.entries(scene.noise).filter(([name, value]) => value !== 0 && !SLIDERS.some(([, rate]) => rate === name));
    this.more.textContent = others.map(([name, value]) => `${name} = ${value}`).join(", ");
    if (this.zonesShown !== scene.zones) this.updateZones(scene);
  }

  updateBeacon({ scene }) {
    const { beacon } = this.session;
    this.form.hidden = !beacon;
    this.said.textContent = beacon ? this.studio.serves(beacon)
      : `${scene.beacons.filter(({ dead }) => !dead).length} beacons. Select one on the map, or add one with the tool “add” (a).`;
    if (!beacon || this.beaconShown === beacon) return;
    this.beaconShown = beacon;
    this.id.value = beacon.id;
    const { name } = beacon.kind;
    if (![...this.kind.options].some(({ value }) => value === name)) this.kind.append(el("option", { value: name }, name));
    this.kind.value = name;
    this.seen.checked = Boolean(beacon.kind.line_of_sight);
    for (const { input, where, unit, row } of this.fields) {
      const value = (where.startsWith("kind.") ? beacon.kind[where.slice(5)] : beacon[where]) ?? null;
      row.hidden = value === null && where !== "facing_deg";
      input.value = value === null ? "" : Number((value / unit).toPrecision(8));
    }
  }

  updateRoutes({ scene, drifts, others, worst, otherWorst }) {
    this.lines ??= [];
    this.table.classList.toggle("alone", !this.compared.checked);
    this.trouble.textContent = [...drifts, ...others].find((drift) => drift instanceof Error)?.message ?? "";
    while (this.lines.length > scene.routes.length) this.lines.pop().node.remove();
    scene.routes.forEach((route, k) => {
      const line = this.lines[k] ?? (this.lines[k] = this.rowOf(k)), { cells } = line;
      line.pick.checked = k === this.session.selected.route;
      line.name.textContent = route.name;
      const broken = drifts[k] instanceof Error, { limit_m: limit } = route, over = exceeds(worst[k], limit);
      cells[1].textContent = broken ? "–" : drifts[k].length.toFixed(1);
      cells[2].textContent = broken ? "–" : worst[k].toFixed(3);
      cells[3].textContent = others[k] instanceof Error ? "–" : others[k] ? otherWorst[k].toFixed(3) : "";
      if (document.activeElement !== line.limit) line.limit.value = limit ?? "";
      line.limit.setAttribute("aria-label", `limit of ${route.name}, metres`);
      cells[5].textContent = broken || limit === null ? "" : over ? "✗ exceeds" : "✓ keeps";
      cells[5].className = over ? "over" : "";
    });
  }

  updateZones({ zones }) {
    const { session } = this;
    this.zonesShown = zones;
    this.zones.replaceChildren(...zones.map((zone, k) => {
      const factor = el("input", { type: "number", min: "0", step: "any", value: zone.factor ?? "", onchange: () => {
        const value = Number(factor.value);
        if (value > 0) session.change("zones", k, { factor: value, noise: worse(session.scene.noise, value) });
      } });
      return el("div", { class: "row" }, el("label", {}, `floor ${k + 1}, times the noise elsewhere`, factor),
        button("Delete", () => session.remove("zones", k)));
    }));
  }
}
