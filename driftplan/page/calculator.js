// Drift of every route of a scene, computed anew only where something changed that it depends on.
//
// A scene is what examples/guide/studio.md describes; it is never changed in place: an edit makes a new scene that
// shares what stayed, and what is shared is not computed again.
import { fullNoise } from "./elements.js";
import { predict } from "./drift.js";
import { cutAtZones, legsOf, passesOf, readingsOf, Walls } from "./passes.js";

const NEEDS_FILTER = "a range or a bearing needs the estimator “filter”: a robot that replaces what it reads cannot use it";

export class Calculator {
  constructor(scene) {
    this.walls = new Walls(scene.walls);
    const [noises, paths, floors, readings, reset, filter] = Array.from({ length: 6 }, () => new WeakMap());
    Object.assign(this, { noises, paths, floors, readings, drifts: { reset, filter } });
  }

  /** The drift of one route with all beacons that are alive, or an Error that says why there is none. */
  drift(scene, route, estimator = scene.estimator) {
    const known = this.drifts[estimator].get(route), read = this.read(scene.beacons, route, known);
    const depends = [scene.noise, scene.zones, scene.start_fix];
    let drift = known?.drift;
    if (!known || depends.some((x, k) => x !== known.depends[k]) || !same(read, known.read)) {
      drift = this.computed(scene, route, read.flat(), estimator);
    }
    this.drifts[estimator].set(route, { beacons: scene.beacons, read, depends, drift });
    return drift;
  }

  /** The readings of a route, beacon by beacon; if no beacon that it meets has changed, those that are known. */
  read(beacons, route, known) {
    if (known?.beacons === beacons) return known.read;
    const of = (beacon) => (beacon.dead ? [] : this.readingsOn(route, beacon));
    const changed = known && this.changes(known.beacons, beacons);
    if (changed?.every((k) => !of(known.beacons[k]).length && !of(beacons[k]).length)) return known.read;
    return beacons.map(of).filter((here) => here.length);
  }

  /** Which beacons of a list differ from those of another, or null where their number does. */
  changes(before, after) {
    if (this.compared?.before !== before || this.compared?.after !== after) {
      const places = before.length === after.length ? [...after.keys()].filter((k) => before[k] !== after[k]) : null;
      this.compared = { before, after, places };
    }
    return this.compared.places;
  }

  computed(scene, route, readings, estimator) {
    if (estimator === "reset" && readings.some(({ anchor }) => anchor)) return new Error(NEEDS_FILTER);
    const { points, zone } = this.floorOf(scene, route);
    const noises = zone.map((k) => this.full(k < 0 ? scene.noise : scene.zones[k].noise));
    try {
      return predict(points, noises, [...startReadings(scene.start_fix), ...readings], estimator);
    } catch (error) {
      return error;
    }
  }

  full(noise) {
    if (!this.noises.has(noise)) this.noises.set(noise, fullNoise(noise));
    return this.noises.get(noise);
  }

  floorOf(scene, route) {
    const known = this.floors.get(route);
    if (known && known.zones === scene.zones) return known;
    const found = { zones: scene.zones, ...cutAtZones(route.points, scene.zones) };
    this.floors.set(route, found);
    return found;
  }

  /** A route as legs. */
  pathOf(route) {
    if (!this.paths.has(route)) this.paths.set(route, legsOf(route.points));
    return this.paths.get(route);
  }

  readingsOn(route, beacon) {
    if (!this.readings.has(route)) this.readings.set(route, new WeakMap());
    const known = this.readings.get(route);
    if (!known.has(beacon)) {
      const path = this.pathOf(route);
      known.set(beacon, readingsOf(path, beacon, passesOf(path, beacon, this.walls)));
    }
    return known.get(beacon);
  }
}

function startReadings(fix) {
  if (!fix) return [];
  const cov = fix.position_cov, variance = fix.heading_std === null ? null : fix.heading_std ** 2;
  return [{ s: 0, square: cov && cov[0][0] + cov[1][1], skew: cov && [cov[0][0] - cov[1][1], 2 * cov[0][1]],
    headingVar: variance, chance: fix.detection_probability ?? 1, anchor: null, rangeVar: null, bearingVar: null }];
}

/** Whether two lists hold the same things. */
export function same(some, others) { return some === others || (some.length === others.length && some.every((x, k) => x === others[k])); }
