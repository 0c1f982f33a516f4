// Drift along a path with readings on the way: driftplan/model/drive.py, paths.py (Runs.cut), drift.py and worst.py.
import { engineOf } from "./estimators.js";
import { legsOf, placeAt, wrap } from "./passes.js";

const SAME_PLACE_M = 1.5e-6, LOST_SHARE = 1e-9, PARTS = 8, CLOSE = 1e-10;  // of paths.py and worst.py

/** Drift of a robot that follows `points` (with a border at every change of floor) and takes `readings` on its way.
 * noises: one per leg, full. readings: as of passes.js; those without an `accuracy` are fixes of the start. Returns a Drift. */
export function predict(points, noises, readings, estimator) {
  const path = legsOf(points), { runs, at } = cut(path, noises, readings);
  const engine = engineOf(estimator, [...new Set(noises)]);
  const due = runs.map(() => []).concat([[]]), ofStart = [];
  readings.forEach((reading, k) => {
    if (at[k] === 0 && !reading.accuracy) ofStart.push(reading);
    else due[at[k]].push(reading);
  });
  for (const here of due) here.sort(laterIfBetter);
  const [{ heading }] = runs, [[x, y]] = points;
  let state = engine.start(Math.cos(heading), Math.sin(heading), x, y, ofStart);
  const arriving = [state], leaving = [], departing = [];
  const take = (border) => {
    for (const reading of due[border]) state = engine.read(state, reading);
    leaving.push(state);
  };
  runs.forEach(({ turn, length, noise }, border) => {
    take(border);
    departing.push(turn === 0 ? state : engine.step(state, turn, 0, noise));
    state = engine.step(state, turn, length, noise);
    arriving.push(state);
  });
  take(runs.length);
  return new Drift(engine, path, runs, { arriving, leaving, departing });
}

/** Of readings at one place the most accurate comes last: by position, then by heading; what is not measured first. */
function laterIfBetter({ accuracy: a }, { accuracy: b }) {
  if (!a || !b) return (a ? 1 : 0) - (b ? 1 : 0);
  for (const k of [0, 1]) {
    if (a[k] < b[k]) return -1;
    if (a[k] > b[k]) return 1;
  }
  return 0;
}

/** The legs of a path cut at readings, and the border at which each is taken. */
function cut({ legs, length }, noises, readings) {
  const ends = [0, ...legs.map((leg) => leg.begin + leg.length)], within = Math.max(SAME_PLACE_M, LOST_SHARE * length);
  const places = readings.map(({ s }) => Math.min(s, length)), free = [];
  places.forEach((s, k) => {
    const after = Math.min(Math.max(lowerBound(ends, s), 1), ends.length - 1);
    const near = s - ends[after - 1] < ends[after] - s ? ends[after - 1] : ends[after];
    if (Math.abs(s - near) <= within) places[k] = near;
    else free.push(k);
  });
  free.sort((i, j) => places[i] - places[j]);
  const inner = [];
  let previous = -Infinity;
  for (const k of free) {
    if (places[k] - previous > within) inner.push(places[k]);
    previous = places[k];
    places[k] = inner[inner.length - 1];
  }
  let course = legs.find((leg) => leg.length > 0)?.angle ?? 0, next = 0;
  const runs = [], borders = [0];
  legs.forEach((leg, k) => {
    const heading = leg.length > 0 ? leg.angle : course, turn = k === 0 ? 0 : wrap(heading - course);
    course = heading;
    const stops = [ends[k]];
    while (next < inner.length && inner[next] < ends[k + 1]) stops.push(inner[next++]);
    stops.push(ends[k + 1]);
    for (let i = 1; i < stops.length; i++) {
      const driven = stops.length === 2 ? leg.length : stops[i] - stops[i - 1];
      runs.push({ turn: i === 1 ? turn : 0, length: driven, heading, noise: noises[k] });
    }
    borders.push(...stops.slice(1));
  });
  return { runs, at: places.map((s) => lowerBound(borders, s)) };
}

function lowerBound(sorted, x) {
  let low = 0, high = sorted.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (sorted[middle] < x) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Drift at every border of a path: metres driven `s`, E|e|² on arrival `N0`, after readings `N1`. */
class Drift {
  constructor(engine, path, runs, states) {
    Object.assign(this, { engine, path, runs, ...states });
    this.s = [0];
    for (const { length } of runs) this.s.push(this.s[this.s.length - 1] + length);
    this.N0 = states.arriving.map((state) => engine.square(state));
    this.N1 = states.leaving.map((state, k) => (state === states.arriving[k] ? this.N0[k] : engine.square(state)));
    this.N2 = states.departing.map((state, k) => (state === states.leaving[k] ? this.N1[k] : engine.square(state)));
    this.worst = this.greatest();
  }

  get length() { return this.path.length; }

  /** Error moments after s metres, had the path ended there: after the readings there. */
  at(s) {
    const k = Math.min(Math.max(lowerBound(this.s, s + SAME_PLACE_M / 3) - 1, 0), this.runs.length);
    if (k === this.runs.length || s <= this.s[k]) return this.engine.error(this.leaving[k]);
    return this.engine.error(this.engine.step(this.leaving[k], this.runs[k].turn, s - this.s[k], this.runs[k].noise));
  }

  /** E|e|² at shares of a run, by the cubic through its ends with their slopes: exact for a filter, for drawing else. */
  between(k) {
    const { length, noise } = this.runs[k], n0 = this.N2[k], n1 = this.N0[k + 1];
    const m0 = this.engine.slope(this.departing[k], noise) * length;
    const m1 = this.engine.slope(this.arriving[k + 1], noise) * length;
    return (t) => n0 + t * (m0 + t * (3 * (n1 - n0) - 2 * m0 - m1 + t * (2 * (n0 - n1) + m0 + m1)));
  }

  /** Points of the curve of drift against distance, [s, rms], about `spacing` metres apart. */
  curve(spacing) {
    const points = [[0, root(this.N0[0])]];
    this.runs.forEach(({ length }, k) => {
      const count = Math.max(1, Math.ceil(length / spacing)), at = this.between(k), s = this.s[k];
      if (this.N1[k] !== this.N0[k]) points.push([s, root(this.N1[k])]);
      if (this.N2[k] !== this.N1[k]) points.push([s, root(this.N2[k])]);
      for (let i = 1; i < count; i++) points.push([s + length * i / count, root(at(i / count))]);
      points.push([this.s[k + 1], root(this.N0[k + 1])]);
    });
    points.push([this.length, root(this.N1.at(-1))]);
    return points;
  }

  /** The greatest rms anywhere, as worst_rms finds it: at borders, after readings and turns, and inside runs. */
  greatest() {
    const borders = [this.N0.slice(1), this.N1, this.N2].flat().reduce((x, y) => Math.max(x, y), 0);
    return Math.sqrt(this.runs.reduce((greatest, _, k) => this.worstInside(k, greatest), borders));
  }

  worstInside(k, greatest) {
    const { length, noise } = this.runs[k], inside = (s) => this.engine.square(this.engine.step(this.departing[k], 0, s, noise));
    if (this.engine.constants) {  // of a filter: a cubic that is convex, or a polynomial of degree four
      if (this.engine.systematic || this.engine.constants.length) return greatestOfQuartic(inside, length, greatest);
      return greatest;
    }
    const [bend, fixed] = this.rates(noise);
    const open = [[0, length, this.N2[k], this.N0[k + 1]]];
    while (open.length) {
      const [from, to, begin, end] = open.pop(), h = (to - from) ** 2 / 8;
      if (ceiling(begin, end, bend * h, fixed * h) <= greatest * (1 + CLOSE)) continue;
      const N = [begin];
      for (let i = 1; i < PARTS; i++) N.push(inside(from + (to - from) * i / PARTS));
      N.push(end);
      greatest = Math.max(greatest, ...N);
      for (let i = 0; i < PARTS; i++) {
        open.push([from + (to - from) * i / PARTS, from + (to - from) * (i + 1) / PARTS, N[i], N[i + 1]]);
      }
    }
    return greatest;
  }

  /** -(E|e|²)'' on a straight run is at most the first times the rms plus the second. */
  rates(noise) {
    const covariance = noise.heading_distance_corr * Math.sqrt(noise.heading_var_per_m * noise.distance_var_per_m);
    const drives = this.engine.onDrives ? this.engine.onDrives(noise) : [noise];
    const bend = drives.map((one) => 2 * Math.hypot(1 + one.distance_scale_error, covariance / 2)
      * Math.hypot(one.heading_var_per_m / 2, one.heading_bias_per_m));
    return [Math.max(...bend), covariance ** 2];
  }

  /** Where the heading's standard deviation exceeds 0.15 rad and a filter is not to be trusted. */
  get beyondLinear() { return Boolean(this.engine.constants) && this.arriving.some(({ S }) => S[2 * this.engine.size + 2] > 0.15 ** 2); }

  /** Stretches on which the rms exceeds a limit, [from, to] in metres. */
  above(limit, spacing) {
    const found = [];
    let open = false;
    for (const [s, rms] of this.curve(spacing)) {
      if (!exceeds(rms, limit)) open = false;
      else if (open) found.at(-1)[1] = s;
      else open = found.push([s, s]) > 0;
    }
    return found;
  }

  /** Where the robot is after s metres. */
  place(s) { return placeAt(this.path, s); }
}

/** Whether a drift is beyond a limit, null where there is none. */
export function exceeds(rms, limit) { return limit !== null && rms > limit * (1 + 1e-6); }

const root = (square) => Math.sqrt(Math.max(square, 0));

function ceiling(begin, end, bend, fixed) {
  const higher = Math.max(begin, end, 0);
  const most = 0.25 * (bend + Math.sqrt(bend ** 2 + 4 * (higher + fixed))) ** 2;
  const sag = bend * Math.sqrt(most) + fixed, apart = Math.min(Math.abs(end - begin), 4 * sag);
  return higher - apart / 2 + sag + apart ** 2 / Math.max(16 * sag, 1e-300);
}

/** The greatest value of a polynomial of degree four on [0, length], from five of its values. */
function greatestOfQuartic(value, length, greatest) {
  if (length === 0) return greatest;
  const y = [0, 1, 2, 3, 4].map((i) => value(length * i / 4));
  const d = y.slice();  // its forward differences
  for (let k = 1; k < 5; k++) for (let i = 4; i >= k; i--) d[i] -= d[i - 1];
  const at = (t) => d[0] + t * (d[1] + (t - 1) / 2 * (d[2] + (t - 2) / 3 * (d[3] + (t - 3) / 4 * d[4])));
  let best = 2;
  for (let reach = 2; reach > 1e-9; reach /= 8) {
    const near = Array.from({ length: 33 }, (_, i) => Math.min(Math.max(best + reach * (i - 16) / 16, 0), 4));
    best = near.reduce((x, t) => (at(t) > at(x) ? t : x));
  }
  return Math.max(greatest, ...y, at(best));
}
