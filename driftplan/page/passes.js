// Where paths come into the range and sight of beacons, and where they cross floors: driftplan/beacons/passes.py,
// readings.py and driftplan/world/zones.py, with plain geometry instead of shapely.

const TOUCH = 1e-9, FLAT = 1e-9, ANGLE = 1e-12;  // m, m, rad: as near as this is the same
const DECIMALS = 1e6, POINT_M = 1e-6, PAST_CORNER = 1e-9;  // rounding of distances; least pass, m; of a side's length

const cross = (ax, ay, bx, by) => ax * by - ay * bx;

/** In (-π, π], a half turn to the left. */
export function wrap(angle) {
  const left = Math.PI + 1e-6, rest = (left - angle) % (2 * Math.PI);
  return left - (rest < 0 ? rest + 2 * Math.PI : rest);
}

/** Legs of a polyline: where each begins, its direction, its length, and the metres driven before it. */
export function legsOf(points) {
  const legs = [];
  let begin = 0;
  for (let k = 0; k + 1 < points.length; k++) {
    const [x, y] = points[k], dx = points[k + 1][0] - x, dy = points[k + 1][1] - y, length = Math.hypot(dx, dy);
    const [ux, uy] = length > 0 ? [dx / length, dy / length] : [0, 0];
    legs.push({ x, y, ux, uy, length, begin, angle: Math.atan2(dy, dx) });
    begin += length;
  }
  return { legs, length: begin };
}

/** Walls that block sight, as edges in a grid of cells. */
export class Walls {
  constructor(polygons) {
    this.polygons = polygons;
    this.edges = polygons.flatMap((rings) => rings.flatMap((ring) => ring.slice(1).map(([x, y], k) => [ring[k][0], ring[k][1], x, y])));
    const span = this.edges.reduce((sum, [ax, ay, bx, by]) => sum + Math.abs(bx - ax) + Math.abs(by - ay), 0);
    this.cell = Math.max(span / Math.max(this.edges.length, 1), 0.5);
    this.cells = new Map();
    this.edges.forEach(([ax, ay, bx, by], k) => {
      for (const key of this.keys(Math.min(ax, bx), Math.min(ay, by), Math.max(ax, bx), Math.max(ay, by))) {
        this.cells.set(key, [...(this.cells.get(key) ?? []), k]);
      }
    });
  }

  *keys(left, low, right, high) {
    const c = this.cell;
    for (let i = Math.floor(left / c); i <= Math.floor(right / c); i++) {
      for (let j = Math.floor(low / c); j <= Math.floor(high / c); j++) yield `${i},${j}`;
    }
  }

  /** Edges whose cells meet a box. */
  near(left, low, right, high) {
    const found = new Set();
    for (const key of this.keys(left, low, right, high)) for (const k of this.cells.get(key) ?? []) found.add(k);
    return [...found].map((k) => this.edges[k]);
  }

  inside(x, y) { return this.polygons.some((rings) => insideRings(rings, x, y)); }

  /** The stretches of the chord from a to b (length metres) from which `eye` is seen, [from, to] in metres. */
  seen(eye, a, b, length) {
    const [ex, ey] = eye, xs = [ex, a[0], b[0]], ys = [ey, a[1], b[1]];
    const edges = this.near(Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys));
    if (this.inside(ex, ey)) return [];
    const isPoint = length < FLAT, end = isPoint ? eye : b, span = Math.hypot(end[0] - a[0], end[1] - a[1]);
    if (edges.length === 0 || span === 0) return [[0, length]];  // none, or the eye is there
    const ux = (end[0] - a[0]) / span, uy = (end[1] - a[1]) / span, onLine = Math.abs(cross(ux, uy, ex - a[0], ey - a[1])) < FLAT;
    const shadows = isPoint || onLine ? shadowsOnLine(edges, eye, a, ux, uy, length) : shadowsOf(edges, eye, a, b, length);
    if (!shadows.length) return [[0, length]];
    return isPoint ? [] : gaps(shadows, length);
  }

  /** The place on a wall nearest to a point, or null if none is within `reach`. */
  nearest(x, y, reach) {
    let best = null, least = reach;
    for (const [ax, ay, bx, by] of reach < Infinity ? this.near(x - reach, y - reach, x + reach, y + reach) : this.edges) {
      const dx = bx - ax, dy = by - ay, square = dx * dx + dy * dy;
      const t = square > 0 ? Math.min(Math.max(((x - ax) * dx + (y - ay) * dy) / square, 0), 1) : 0;
      const px = ax + t * dx, py = ay + t * dy, off = Math.hypot(px - x, py - y);
      if (off < least) [least, best] = [off, [px, py]];
    }
    return best;
  }
}

/** Whether a point is in a polygon, its outline included. */
function insideRings(rings, x, y) {
  let inside = false;
  for (const ring of rings) {
    for (let k = 0; k + 1 < ring.length; k++) {
      const [ax, ay] = ring[k], [bx, by] = ring[k + 1];
      if ((ay > y) !== (by > y)) {
        const side = cross(bx - ax, by - ay, x - ax, y - ay);
        if (side === 0) return true;
        if (side > 0 === by > ay) inside = !inside;
      } else if (ay === y && by === y && (x - ax) * (x - bx) <= 0) return true;
      else if ((ax === x && ay === y) || (bx === x && by === y)) return true;
    }
  }
  return inside;
}

/** The intervals of the chord from a to b that edges hide from the eye: each clipped to the triangle, seen from it. */
function shadowsOf(edges, [ex, ey], a, b, length) {
  const ax = a[0] - ex, ay = a[1] - ey, bx = b[0] - ex, by = b[1] - ey, area = cross(ax, ay, bx, by);
  const found = [];
  for (const [px, py, qx, qy] of edges) {
    // barycentric coordinates: a point is α a + β b from the eye; in the triangle α, β >= 0 and α + β <= 1
    const at = (x, y) => [cross(x, y, bx, by) / area, cross(ax, ay, x, y) / area];
    const [p0, p1] = at(px - ex, py - ey), [q0, q1] = at(qx - ex, qy - ey);
    let from = 0, to = 1;
    for (const [f, g] of [[p0, q0], [p1, q1], [1 - p0 - p1, 1 - q0 - q1]]) {
      if (f < 0 && g < 0) to = -1;
      else if (f < 0) from = Math.max(from, f / (f - g));
      else if (g < 0) to = Math.min(to, f / (f - g));
    }
    if (from > to) continue;
    const ends = [from, to].map((t) => {
      const alpha = p0 + t * (q0 - p0), beta = p1 + t * (q1 - p1);
      return alpha + beta > 0 ? beta / (alpha + beta) * length : NaN;
    }).filter((t) => !Number.isNaN(t));
    if (ends.length) found.push([Math.min(...ends), Math.max(...ends)]);
  }
  return found;
}

/** The same when the eye is on the chord's line: all that is behind a wall. */
function shadowsOnLine(edges, eye, a, ux, uy, length) {
  const at = (x, y) => (x - a[0]) * ux + (y - a[1]) * uy, off = (x, y) => cross(ux, uy, x - a[0], y - a[1]);
  const beacon = at(...eye), low = Math.min(beacon, 0), high = Math.max(beacon, length), found = [];
  for (const [px, py, qx, qy] of edges) {
    const o1 = off(px, py), o2 = off(qx, qy);
    if (o1 * o2 > 0) continue;
    const places = o1 === o2 ? [at(px, py), at(qx, qy)] : [at(px + (qx - px) * o1 / (o1 - o2), py + (qy - py) * o1 / (o1 - o2))];
    for (const s of places) {
      if (s < low || s > high) continue;
      found.push(s >= beacon ? [s, Infinity] : [-Infinity, s]);
    }
  }
  return found;
}

/** What shadows leave of [0, length]. */
function gaps(shadows, length) {
  const found = [];
  let reached = 0;
  for (const [start, end] of shadows.sort((x, y) => x[0] - y[0])) {
    found.push([reached, Math.min(start, length)]);
    reached = Math.max(reached, end);
  }
  found.push([reached, length]);
  return found.filter(([x, y]) => y - x > 1e-6);
}

/** The part of a leg within a disc, [from, to] in metres, or null. */
function chordInDisc({ x, y, ux, uy, length }, bx, by, radius) {
  const ox = bx - x, oy = by - y, foot = ox * ux + oy * uy;
  const off = length > 0 ? Math.abs(cross(ox, oy, ux, uy)) : Math.hypot(ox, oy);
  if (off > radius + TOUCH) return null;
  const half = Math.sqrt(Math.max(radius * radius - off * off, 0));
  const start = Math.max(foot - half, 0), end = Math.min(foot + half, length);
  if (start > end + TOUCH) return null;
  return start > end ? [(start + end) / 2, (start + end) / 2] : [start, end];
}

/** The parts of a chord within `half` of the direction `axis` from the beacon. */
function inCone(chord, leg, bx, by, axis, half) {
  if (half >= Math.PI) return [chord];
  const sides = [1, -1].map((side) => {
    const er = Math.cos(axis + side * half), ei = Math.sin(axis + side * half);
    const inside = -side * (er * (leg.y - by) - ei * (leg.x - bx)), rate = -side * (er * leg.uy - ei * leg.ux);
    const border = Math.abs(rate) > ANGLE ? -inside / rate : inside >= -FLAT ? -Infinity : Infinity;
    return rate >= -ANGLE ? [Math.max(border, chord[0]), chord[1]] : [chord[0], Math.min(border, chord[1])];
  });
  const [[s1, e1], [s2, e2]] = sides, wide = half > Math.PI / 2, apart = wide && Math.max(s1, s2) > Math.min(e1, e2);
  const parts = apart ? sides : [wide ? [Math.min(s1, s2), Math.max(e1, e2)] : [Math.max(s1, s2), Math.min(e1, e2)]];
  return parts.filter(([s, e]) => s <= e + TOUCH).map(([s, e]) => (s > e ? [(s + e) / 2, (s + e) / 2] : [s, e]));
}

/** All passes of a path ({legs, length}) through the range of one beacon: [enter, leave] in metres driven. */
export function passesOf({ legs, length }, beacon, walls) {
  const { kind, x, y } = beacon, found = [], rad = Math.PI / 180;
  const view = rad * (kind.view_angle_deg ?? 360) / 2, sensor = rad * (kind.sensor_view_deg ?? 360) / 2;
  const facing = rad * (beacon.facing_deg ?? 0), reach = kind.range_m + TOUCH;
  for (const leg of legs) {
    const ex = leg.x + leg.ux * leg.length, ey = leg.y + leg.uy * leg.length;
    if (x + reach < Math.min(leg.x, ex) || x - reach > Math.max(leg.x, ex) || y + reach < Math.min(leg.y, ey)
        || y - reach > Math.max(leg.y, ey)) continue;
    const chord = chordInDisc(leg, x, y, kind.range_m);
    if (!chord) continue;
    let parts = inCone(chord, leg, x, y, facing, view);
    if (sensor < Math.PI) {
      parts = leg.length > 0 ? parts.flatMap((part) => inCone(part, leg, x, y, leg.angle + Math.PI, sensor)) : [];
    }
    if (kind.line_of_sight && walls.edges.length) {
      parts = parts.flatMap(([s, e]) => {
        const a = [leg.x + s * leg.ux, leg.y + s * leg.uy], b = [leg.x + e * leg.ux, leg.y + e * leg.uy];
        return walls.seen([x, y], a, b, e - s).map(([from, to]) => [s + from, s + to]);
      });
    }
    for (const [s, e] of parts) found.push([leg.begin + s, leg.begin + e]);
  }
  found.sort((p, q) => p[0] - q[0]);
  const merged = [];
  for (const [enter, leave] of found) {
    const last = merged.at(-1);
    if (last && enter <= last.until + 2 * TOUCH) last.leave = Math.max(last.leave, leave);
    else merged.push({ enter, leave });
    merged.at(-1).until = leave;
  }
  const snapped = (s) => { const r = Math.round(s * DECIMALS) / DECIMALS; return r >= length - 1 / DECIMALS ? length : r; };
  return merged.map(({ enter, leave }) => [snapped(enter), snapped(leave)]);
}

/** The readings of one beacon's passes, in driving order. */
export function readingsOf(path, beacon, passes) {
  const { kind } = beacon, found = [];
  const accuracy = [kind.position_std_m, kind.heading_std].map((std) => (std === null || std === undefined ? -Infinity : -std));
  for (const [enter, leave] of passes) {
    const length = leave - enter, parts = Math.max(Math.ceil(length / (kind.reading_spacing_m ?? 3) - 1e-6), 1);
    const count = length < POINT_M ? 1 : parts + 1, probability = kind.detection_probability ?? 1;
    const chance = 1 - (1 - probability) ** (1 / count);
    for (let step = 0; step < count; step++) {
      const s = enter + length * step / Math.max(count - 1, 1), [px, py] = placeAt(path, s);
      const looser = (kind.std_per_m ?? 0) * Math.hypot(px - beacon.x, py - beacon.y);
      const variance = (std, more = 0) => (std === null || std === undefined ? null : (std + more) ** 2);
      const square = variance(kind.position_std_m, looser);
      const rangeVar = variance(kind.range_std_m, looser), bearingVar = variance(kind.bearing_std);
      found.push({ s, square: square === null ? null : 2 * square, skew: [0, 0], headingVar: variance(kind.heading_std),
        chance, accuracy, rangeVar, bearingVar, anchor: rangeVar !== null || bearingVar !== null ? [beacon.x, beacon.y] : null });
    }
  }
  return found;
}

/** Where a path is after s metres. */
export function placeAt({ legs }, s) {
  let k = 0;
  while (k + 1 < legs.length && legs[k + 1].begin <= s) k++;
  const { x, y, ux, uy, begin } = legs[k], on = Math.min(s - begin, legs[k].length);
  return [x + ux * on, y + uy * on];
}

/** The path cut where the floor changes, and the zone of every leg, -1 outside all. The last of several holds. */
export function cutAtZones(points, zones) {
  if (!zones.length) return { points, zone: points.slice(1).map(() => -1) };
  const sides = zones.flatMap(({ polygons }) => polygons.flatMap((rings) => rings.flatMap((ring) =>
    ring.slice(1).map((end, k) => [ring[k], end]))));
  const at = (x, y) => zones.findLastIndex(({ polygons }) => polygons.some((rings) => insideRings(rings, x, y)));
  const out = [points[0]], zone = [];
  for (let k = 0; k + 1 < points.length; k++) {
    const [ax, ay] = points[k], dx = points[k + 1][0] - ax, dy = points[k + 1][1] - ay, cuts = [0, 1];
    for (const [[px, py], [qx, qy]] of sides) {
      const slant = cross(dx, dy, qx - px, qy - py);
      const t = cross(px - ax, py - ay, qx - px, qy - py) / slant, u = cross(px - ax, py - ay, dx, dy) / slant;
      if (t > 0 && t < 1 && Math.abs(u - 0.5) <= 0.5 + PAST_CORNER) cuts.push(t);
    }
    cuts.sort((x, y) => x - y);
    const begun = out.length;
    for (let i = 0; i + 1 < cuts.length; i++) {
      if (!(cuts[i + 1] - cuts[i] > 1e-12 || (dx === 0 && dy === 0))) continue;
      const middle = (cuts[i] + cuts[i + 1]) / 2, here = at(ax + middle * dx, ay + middle * dy);
      if (out.length > begun && zone.at(-1) === here) out.pop();  // the same floor goes on
      else zone.push(here);
      out.push(cuts[i + 1] < 1 ? [ax + cuts[i + 1] * dx, ay + cuts[i + 1] * dy] : points[k + 1]);
    }
  }
  return { points: out, zone };
}
