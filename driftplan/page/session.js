// What is being edited: the scene, its history, and what is selected. Edits make new scenes; nothing is changed in place.

const KINDS = {
  rfid: { range_m: 1.5, position_std_m: 0.1 },
  landmark: { range_m: 4, position_std_m: 0.05, heading_std: 0.02, line_of_sight: true },
  heading: { range_m: 3, heading_std: 0.02 },
  range_only: { range_m: 10, range_std_m: 0.1 },
  bearing: { range_m: 10, bearing_std: 0.02, line_of_sight: true },
};
export const KIND_NAMES = Object.keys(KINDS);

/** A kind of beacon with its usual values. */
export function usualKind(name) {
  return { name, detection_probability: 1, line_of_sight: false, reading_spacing_m: 3, cost: 1, std_per_m: 0,
    view_angle_deg: 360, sensor_view_deg: 360, ...KINDS[name] };
}

export class Session {
  constructor(scene) {
    Object.assign(this, { scene, past: [], future: [], listeners: [], merging: null });
    this.selected = { beacon: null, route: 0, waypoint: null };
  }

  listen(listener) { this.listeners.push(listener); }
  changed() { for (const listener of this.listeners) listener(); }

  /** Replace parts of the scene. Edits with the same `merge`, one after the other, are one step of the history. */
  edit(change, merge = null) {
    if (merge === null || merge !== this.merging) this.past.push(this.scene);
    this.merging = merge;
    this.future = [];
    this.scene = { ...this.scene, ...change };
    this.changed();
  }

  /** What comes next is a step of its own. */
  settle() {
    if (this.merging === null) return;
    this.merging = null;
    this.changed();
  }

  undo() { this.travel(this.past, this.future); }
  redo() { this.travel(this.future, this.past); }

  travel(from, to) {
    if (!from.length) return;
    to.push(this.scene);
    this.scene = from.pop();
    this.merging = null;
    const { selected } = this;
    Object.assign(selected, { waypoint: null, beacon: this.beacon && selected.beacon, route: this.route ? selected.route : 0 });
    this.changed();
  }

  select(change) {
    Object.assign(this.selected, change);
    this.changed();
  }

  get beacon() { return this.scene.beacons[this.selected.beacon] ?? null; }
  get route() { return this.scene.routes[this.selected.route] ?? null; }

  /** Change one of the "beacons", "routes" or "zones". */
  change(list, index, change, merge = null) {
    this.edit({ [list]: this.scene[list].map((one, k) => (k === index ? { ...one, ...change } : one)) }, merge);
  }

  remove(list, index) {
    this.selected.beacon = null;
    this.edit({ [list]: this.scene[list].filter((_, k) => k !== index) });
  }

  changeBeacon(index, change, merge = null) { this.change("beacons", index, change, merge); }

  addBeacon(beacon) {
    const taken = new Set(this.scene.beacons.map(({ id }) => id));
    let number = this.scene.beacons.length + 1, id = beacon.id;
    while (!id || taken.has(id)) id = `${beacon.kind.name}-${number++}`;
    this.selected.beacon = this.scene.beacons.length;
    this.edit({ beacons: [...this.scene.beacons, { facing_deg: null, existing: false, ...beacon, id }] });
  }

  moveWaypoint(index, point, merge = null) {
    const points = this.route.points.map((old, k) => (k === index ? point : old));
    this.change("routes", this.selected.route, { points }, merge);
  }

  insertWaypoint(after) {
    const { points } = this.route, k = Math.min(after, points.length - 2);
    const middle = [0, 1].map((axis) => (points[k][axis] + points[k + 1][axis]) / 2);
    this.selected.waypoint = k + 1;
    this.change("routes", this.selected.route, { points: [...points.slice(0, k + 1), middle, ...points.slice(k + 1)] });
  }

  removeWaypoint(index) {
    if (this.route.points.length <= 2) return;
    this.selected.waypoint = null;
    this.change("routes", this.selected.route, { points: this.route.points.filter((_, k) => k !== index) });
  }

  /** A rectangle of floor on which odometry errs `factor` times as much. */
  addZone([x0, y0], [x1, y1], factor) {
    const [left, right, low, high] = [Math.min(x0, x1), Math.max(x0, x1), Math.min(y0, y1), Math.max(y0, y1)];
    const ring = [[left, low], [right, low], [right, high], [left, high], [left, low]];
    this.edit({ zones: [...this.scene.zones, { polygons: [[ring]], noise: worse(this.scene.noise, factor), factor }] });
  }
}

/** A noise with standard deviations `factor` times as large. */
export function worse(noise, factor) {
  return Object.fromEntries(Object.entries(noise).map(([name, value]) => [name, name.includes("_var_") ? value * factor ** 2 : value]));
}
