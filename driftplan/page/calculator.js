// Drift of every route of a scene, computed anew only where something changed that it depends on.
//
// A scene is what examples/guide/studio.md describes; it is never changed in place: an edit makes a new scene that
// shares what stayed, and what is shared is not computed again.
import { fullNoise, kept } from "./elements.js";
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
    const known = this.drifts[estimator].get(route);
    const read = known?.beacons === scene.beacons ? known.read : this.read(scene.beacons, route);
    const depends = [scene.noise, scene.zones, scene.start_fix];
    const stays = known && same(depends, known.depends) && same(read, known.read);
    const drift = stays ? known.drift : this.predicted(scene, route, read.flat(), estimator);
    this.drifts[estimator].set(route, { beacons: scene.beacons, read, depends, drift });
    return drift;
  }

  /** The readings of a route, beacon by beacon, of those that are alive and met. */
  read(beacons, route) {
    const known = kept(this.readings, route, () => new WeakMap()), found = [];
    for (const beacon of beacons) {
      const here = known.get(beacon) ?? this.readingsOn(route, beacon);
      if (here.length && !beacon.dead) found.push(here);
    }
    return found;
  }

  predicted(scene, route, readings, estimator) {
    if (estimator === "reset" && readings.some(({ anchor }) => anchor)) return new Error(NEEDS_FILTER);
    const { points, zone } = this.floorOf(scene, route);
    const noises = zone.map((k) => this.full(k < 0 ? scene.noise : scene.zones[k].noise));
    try {
      return predict(points, noises, [...startReadings(scene.start_fix), ...readings], estimator);
    } catch (error) {
      return error;
    }
  }

  full(noise) { return kept(this.noises, noise, () => fullNoise(noise)); }

  floorOf(scene, route) {
    const known = kept(this.floors, scene.zones, () => new WeakMap());
    return kept(known, route, () => cutAtZones(route.points, scene.zones));
  }

  /** A route as legs. */
  pathOf(route) { return kept(this.paths, route, () => legsOf(route.points)); }

  readingsOn(route, beacon) {
    const known = kept(this.readings, route, () => new WeakMap()), path = this.pathOf(route);
    return kept(known, beacon, () => readingsOf(path, beacon, passesOf(path, beacon, this.walls)));
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
