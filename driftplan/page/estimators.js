// What the two estimators make of driving and of readings: driftplan/model/readings.py (resets) and filter_state.py.
//
// An engine has start(pose, readings), step(state, turn, length, noise), read(state, reading), square(state): E|e|²,
// error(state): {N, e1, e2}, E|e|², E e, E e², and slope(state, noise). A reading: {square, skew, headingVar, chance, anchor,
// rangeVar, bearingVar}, null where a thing is not measured.
import { A, B, compose, D, D1, D2, E1, E2, N, nothing, P, U } from "./moments.js";
import { fullNoise, kept, legMoments, randomPart, SPREADS, SYSTEMATIC, turnsMatter } from "./elements.js";

const SMALL = 2 ** -20;  // on standard deviations: the filter's covariances are the limit for small noise
const KNOWN_SHARE = 1e-14, NEAREST_ANCHOR_M = 0.01;  // of filter_state.py and readings.py

/** Readings replace what they measure. */
class Resets {
  start(ur, ui, x, y, readings) { return readings.reduce((state, reading) => this.read(state, reading), nothing(ur, ui, x, y)); }

  step(state, turn, length, noise) {
    const facing = length === 0 && !turnsMatter(noise);  // an error-free turn only faces elsewhere
    return compose(state, facing ? nothing(Math.cos(turn), Math.sin(turn)) : legMoments(turn, length, noise));
  }

  read(before, { square, skew, headingVar, chance }) {
    const places = square !== null ? 1 : 0, turns = headingVar !== null ? 1 : 0;
    const v = turns ? headingVar : 0, d1 = Math.expm1(-v / 2), d2 = Math.expm1(-2 * v) - 2 * d1;
    const placed = chance * places, turned = chance * turns, after = before.slice();
    const lever = (turned - placed * turns) * d1, keep = 1 - chance, e1 = [before[E1], before[E1 + 1]];
    for (let k = 0; k < 2; k++) {
      after[D1 + k] *= 1 - turned;
      after[D2 + k] *= 1 - turned;
      after[E1 + k] *= 1 - placed;
      after[E2 + k] *= 1 - placed;
      after[A + k] = keep * before[A + k] + lever * e1[k];
      after[B + k] = keep * before[B + k] + lever * e1[k];
    }
    after[D1] += turned * d1;
    after[D2] += turned * d2;
    after[D] = (1 - turned) * before[D] - 2 * turned * d1;
    after[N] = (1 - placed) * before[N] + placed * (square ?? 0);
    for (let k = 0; k < 2; k++) after[E2 + k] += placed * (skew?.[k] ?? 0);
    return after;
  }

  square(state) { return state[N]; }
  error(state) { return { N: state[N], e1: [state[E1], state[E1 + 1]], e2: [state[E2], state[E2 + 1]] }; }

  /** dE|e|²/ds on driving straight on. */
  slope(state, noise) {
    const gr = noise.distance_scale_error;
    const gi = noise.heading_distance_corr * Math.sqrt(noise.heading_var_per_m * noise.distance_var_per_m) / 2;
    const ear = state[E1] + state[A], eai = state[E1 + 1] + state[A + 1];
    const re = state[A] + gr * ear + gi * eai, im = state[A + 1] + gr * eai - gi * ear;
    return 2 * (state[U] * re + state[U + 1] * im) + noise.distance_var_per_m + noise.lateral_var_per_m;
  }
}

const THREE = [[-1.7320508075688772, 1 / 6], [0, 2 / 3], [1.7320508075688772, 1 / 6]];
const NODES = [  // of a standard normal variable, and their weights
  [[-2.8569700138728056, 0.011257411327720691], [-1.355626179974266, 0.2220759220056126], [0, 0.5333333333333333],
    [1.355626179974266, 0.2220759220056126], [2.8569700138728056, 0.011257411327720691]],
  THREE, THREE];

/** A few drives on which systematic errors differ, whose average is that over all drives of a robot that resets. */
class AveragedResets {
  constructor(noises) {
    this.engine = new Resets();
    let drives = [{ weight: 1, z: [] }];
    SPREADS.forEach((std, axis) => {
      const nodes = noises.some((noise) => noise[std] > 0) ? NODES[axis] : [[0, 1]];
      drives = drives.flatMap(({ weight, z }) => nodes.map(([x, w]) => ({ weight: weight * w, z: [...z, x] })));
    });
    this.drives = drives;
    this.known = new Map();
  }

  /** The noise on every drive. */
  onDrives(noise) {
    return kept(this.known, noise, () => this.drives.map(({ z }) => onDrive(noise, z)));
  }

  start(...pose) {
    const state = this.engine.start(...pose);
    return this.drives.map(() => state);
  }

  step(states, turn, length, noise) {
    const noises = this.onDrives(noise);
    return states.map((state, k) => this.engine.step(state, turn, length, noises[k]));
  }

  read(states, reading) { return states.map((state) => this.engine.read(state, reading)); }
  average(values) { return values.reduce((sum, value, k) => sum + this.drives[k].weight * value, 0); }
  square(states) { return this.average(states.map((state) => state[N])); }

  error(states) {
    const mean = Array.from(nothing(), (_, i) => this.average(states.map((state) => state[i])));
    return this.engine.error(mean);
  }

  slope(states, noise) {
    const noises = this.onDrives(noise);
    return this.average(states.map((state, k) => this.engine.slope(state, noises[k])));
  }
}

/** The noise on a drive whose systematic errors lie so many of their standard deviations off. */
function onDrive(noise, z) {
  const changed = { ...noise };
  SYSTEMATIC.forEach((name, k) => { changed[name] += (z[k] ?? 0) * noise[SPREADS[k]]; });
  changed.distance_scale_error = Math.max(changed.distance_scale_error, -0.99);
  for (const std of SPREADS) changed[std] = 0;
  return changed;
}

/** Readings are fused in a Kalman filter: P of (e_x, e_y, θ, constants), linearised about the true path. */
class Fusion {
  constructor(noises) {
    const spreads = noises.map((noise) => SPREADS.map((std) => noise[std]).join());
    if (new Set(spreads).size > 1) throw new Error("systematic errors must differ alike between drives on all floors");
    this.constants = SYSTEMATIC.filter((_, k) => noises[0][SPREADS[k]] > 0);
    this.variances = SPREADS.map((std) => noises[0][std] ** 2).filter((v) => v > 0);
    this.size = 3 + this.constants.length;
    this.systematic = noises.some((noise) => SYSTEMATIC.some((name) => noise[name] !== 0));
    this.small = new Map(noises.map((noise) => [noise, randomPart(noise, SMALL)]));
  }

  /** Fixes at the start replace what was known about it, whatever the estimator. */
  start(ur, ui, x, y, readings) {
    const at = new Resets().start(ur, ui, x, y, readings), n = this.size, S = new Array(n * n).fill(0);
    const sum = at[N], C = [at[E2], at[E2 + 1]];
    S[0] = (sum + C[0]) / 2;
    S[n + 1] = (sum - C[0]) / 2;
    S[1] = S[n] = C[1] / 2;
    S[2 * n + 2] = Math.max(-Math.log1p(2 * at[D1] + at[D1] ** 2), 0);
    this.variances.forEach((v, k) => { S[(3 + k) * (n + 1)] = v; });
    return { ur, ui, x, y, S, mean: new Array(n).fill(0) };
  }

  step(state, turn, length, noise) {
    const n = this.size, { ur, ui } = state;
    const small = legMoments(turn, length, this.small.get(noise));
    const mx = ur * small[P] - ui * small[P + 1], my = ur * small[P + 1] + ui * small[P];
    const columns = [[2, -my, mx, 0]];  // what the transition adds to the identity: from a state to (x, y, θ)
    const shift = [0, 0, 0];
    for (const name of SYSTEMATIC) {
      const k = this.constants.indexOf(name);
      if (k < 0 && noise[name] === 0) continue;
      const [along, aside, heading] = sensitivity(turn, length, name);
      const x = ur * along - ui * aside, y = ur * aside + ui * along;
      if (k >= 0) columns.push([3 + k, x, y, heading]);
      [x, y, heading].forEach((per, i) => { shift[i] += noise[name] * per; });
    }
    const S = driven(state.S, n, columns);
    const f2r = ur * ur - ui * ui, f2i = 2 * ur * ui, scale = SMALL * SMALL;
    const cr = f2r * small[E2] - f2i * small[E2 + 1], ci = f2r * small[E2 + 1] + f2i * small[E2];
    const hr = (small[B + 1] - small[A + 1]) / 2, hi = -(small[B] - small[A]) / 2;  // (b - a)/2j
    const xt = (ur * hr - ui * hi) / scale, yt = (ur * hi + ui * hr) / scale;
    S[0] += (small[N] + cr) / 2 / scale;
    S[n + 1] += (small[N] - cr) / 2 / scale;
    S[1] = S[n] = S[1] + ci / 2 / scale;
    S[2] = S[2 * n] = S[2] + xt;
    S[n + 2] = S[2 * n + 1] = S[n + 2] + yt;
    S[2 * n + 2] += small[D] / scale;
    const mean = state.mean.slice();
    for (const [k, ...to] of columns) to.forEach((a, i) => { mean[i] += a * state.mean[k]; });
    shift.forEach((x, i) => { mean[i] += x; });
    return { ur: ur * small[U] - ui * small[U + 1], ui: ur * small[U + 1] + ui * small[U], x: state.x + mx, y: state.y + my, S, mean };
  }

  read(state, reading) {
    const n = this.size, S = state.S.slice(), mean = state.mean.slice();
    if (reading.square !== null) for (const axis of [0, 1]) readAxis(S, mean, n, axis, reading.square / 2);
    if (reading.headingVar !== null) readAxis(S, mean, n, 2, reading.headingVar);
    if (reading.anchor) {
      const dx = reading.anchor[0] - state.x, dy = reading.anchor[1] - state.y, rho = Math.hypot(dx, dy);
      if (rho > NEAREST_ANCHOR_M) {
        const gx = dx / rho, gy = dy / rho;
        if (reading.rangeVar !== null) readRow(S, mean, n, [-gx, -gy, 0], reading.rangeVar);
        if (reading.bearingVar !== null) readRow(S, mean, n, [gy / rho, -gx / rho, -1], reading.bearingVar);
      }
    }
    const share = reading.chance;
    if (share !== 1) {  // an upper bound of the expected covariance, by Jensen
      for (let k = 0; k < S.length; k++) S[k] = share * S[k] + (1 - share) * state.S[k];
      const jump = mean.map((m, i) => m - state.mean[i]);
      for (let i = 0; i < n; i++) {
        for (let j = 0; j < n; j++) S[i * n + j] += share * (1 - share) * jump[i] * jump[j];
        mean[i] = state.mean[i] + share * jump[i];
      }
    }
    return { ...state, S, mean };
  }

  square({ S, mean }) { return S[0] + S[this.size + 1] + mean[0] * mean[0] + mean[1] * mean[1]; }

  error({ S, mean: [mx, my] }) {
    const n = this.size;
    return { N: S[0] + S[n + 1] + mx * mx + my * my, e1: [mx, my], e2: [S[0] - S[n + 1] + mx * mx - my * my, 2 * (S[1] + mx * my)] };
  }

  slope({ ur, ui, S, mean }, noise) {
    const n = this.size, scale = this.constants.indexOf("distance_scale_error");
    let slope = 2 * (ur * S[n + 2] - ui * S[2]) + noise.distance_var_per_m + noise.lateral_var_per_m;
    if (scale >= 0) slope += 2 * (ur * S[3 + scale] + ui * S[n + 3 + scale]);
    const stretched = noise.distance_scale_error + (scale >= 0 ? mean[3 + scale] : 0);
    return slope + 2 * (mean[0] * (ur * stretched - ui * mean[2]) + mean[1] * (ui * stretched + ur * mean[2]));
  }
}

/** Position and heading error per unit of a systematic error, facing along x: a central difference at tiny errors. */
function sensitivity(turn, length, name) {
  const [up, down] = [SMALL, -SMALL].map((value) => legMoments(turn, length, fullNoise({ [name]: value })));
  return [E1, E1 + 1, D1 + 1].map((k) => (up[k] - down[k]) / (2 * SMALL));
}

/** A S Aᵀ with A the identity and columns [k, x, y, θ]. */
function driven(S, n, columns) {
  const times = (M, row, step) => {  // A M, or M Aᵀ: what is a row there is a column here
    const out = M.slice();
    for (const [k, ...to] of columns) {
      for (let i = 0; i < 3; i++) {
        if (to[i] !== 0) for (let j = 0; j < n; j++) out[i * row + j * step] += to[i] * M[k * row + j * step];
      }
    }
    return out;
  };
  return times(times(S, n, 1), 1, n);
}

/** A state is measured: its row shrinks by a factor, no digit is lost. */
function readAxis(S, mean, n, axis, variance) {
  const g = S.slice(axis * n, axis * n + n), s = g[axis] + variance, kept = s > 0 ? variance / s : 0;
  readRow(S, mean, n, [0, 1, 2].map((k) => Number(k === axis)), variance);
  for (let k = 0; k < n; k++) S[axis * n + k] = S[k * n + axis] = g[k] * kept;
}

/** h · (e_x, e_y, θ) is measured. */
function readRow(S, mean, n, h, variance) {
  const g = Array.from({ length: n }, (_, k) => h[0] * S[k] + h[1] * S[n + k] + h[2] * S[2 * n + k]);
  const parts = h.reduce((sum, c, i) => sum + c * c * S[i * n + i], 0);
  const s = h[0] * g[0] + h[1] * g[1] + h[2] * g[2] + variance, weight = s > KNOWN_SHARE * parts ? 1 / s : 0;
  for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) S[i * n + j] -= g[i] * g[j] * weight;
  const measured = (h[0] * mean[0] + h[1] * mean[1] + h[2] * mean[2]) * weight;
  for (let k = 0; k < n; k++) mean[k] -= g[k] * measured;
}

/** The engine of an estimator, for a path on floors of these noises. */
export function engineOf(estimator, noises) {
  if (estimator === "filter") return new Fusion(noises);
  return noises.some((noise) => SPREADS.some((std) => noise[std] > 0)) ? new AveragedResets(noises) : new Resets();
}
