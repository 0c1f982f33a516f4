// The moments of one turn and of one run under a noise without steps: driftplan/model/elements.py, piece by piece.
//
// A noise is an object with the fields of OdometryNoise, those that are 0 left out or not.

import { compose, doubled } from "./moments.js";

const ORDER = 12;  // of the Taylor series
const PIECE_RAD = 0.125;  // greatest rotation or heading variance on one piece
const FACTORIAL = [1];
for (let k = 1; k <= ORDER + 1; k++) FACTORIAL.push(FACTORIAL[k - 1] * k);

const RATES = ["heading_var_per_m", "distance_var_per_m", "lateral_var_per_m", "heading_var_per_rad",
  "distance_var_per_rad"];
export const SYSTEMATIC = ["heading_bias_per_m", "heading_bias_per_rad", "distance_scale_error"];
export const SPREADS = ["heading_bias_std_per_m", "heading_bias_std_per_rad", "distance_scale_std"];
export const NOISE_FIELDS = [...RATES, "heading_distance_corr", ...SYSTEMATIC, ...SPREADS];

/** All fields of a noise. */
export function fullNoise(said) {
  const noise = {};
  for (const name of NOISE_FIELDS) noise[name] = said[name] ?? 0;
  return noise;
}

/** The same odometry without systematic errors, `factor` times as noisy. */
export function randomPart(noise, factor) {
  const scaled = fullNoise({ heading_distance_corr: noise.heading_distance_corr });
  for (const name of RATES) scaled[name] = noise[name] * factor * factor;
  return scaled;
}

export function turnsMatter(noise) {
  return noise.heading_var_per_rad !== 0 || noise.distance_var_per_rad !== 0 || noise.heading_bias_per_rad !== 0;
}

/** exp(x + jy) - 1, without cancellation. */
function expm1(x, y) {
  const s = Math.sin(y / 2), e = Math.expm1(x);
  return [e * Math.cos(y) - 2 * s * s, (e + 1) * Math.sin(y)];
}

/** (exp(z) - 1)/z. */
function phi(x, y) {
  const square = x * x + y * y;
  if (square < 1e-200) return [1, 0];
  const [a, b] = expm1(x, y);
  return [(a * x + b * y) / square, (b * x - a * y) / square];
}

/** Moments of a run of `length` metres at a `curvature` (1/m). */
export function runMoments(length, curvature, noise) {
  const bend = Math.abs(curvature);
  return stretch(
    length, curvature, noise.heading_var_per_m + noise.heading_var_per_rad * bend,
    noise.heading_bias_per_m + noise.heading_bias_per_rad * curvature,
    noise.distance_var_per_m + noise.distance_var_per_rad * bend, noise.lateral_var_per_m, 1,
    noise.distance_scale_error, noise.heading_distance_corr);
}

/** Moments of a turn on the spot (rad, positive to the left). */
export function turnMoments(turn, noise) {
  const angle = Math.abs(turn), side = Math.sign(turn);
  if (noise.distance_var_per_rad !== 0 && noise.heading_distance_corr !== 0) {
    return stretch(angle, side, noise.heading_var_per_rad, noise.heading_bias_per_rad * side,
      noise.distance_var_per_rad, 0, 0, 0, noise.heading_distance_corr);
  }
  const v = noise.heading_var_per_rad * angle, spread = noise.distance_var_per_rad * angle;
  const mean = noise.heading_bias_per_rad * turn;
  let d1 = [Math.expm1(-v / 2), 0], d2 = [Math.expm1(-2 * v) - 2 * d1[0], 0];
  if (mean !== 0) {  // g = exp(j mean) - 1, w = 1 + g
    const g = expm1(0, mean), wr = 1 + g[0], wi = g[1], s = 2 * d1[0], t = d2[0];
    d2 = [g[0] * g[0] - g[1] * g[1] + s * (g[0] * wr - g[1] * wi) + t * (wr * wr - wi * wi),
      2 * g[0] * g[1] + s * (g[0] * wi + g[1] * wr) + t * 2 * wr * wi];
    d1 = [g[0] + wr * d1[0], g[1] + wi * d1[0]];
  }
  const swept = spread > 0 ? phi(-2 * v, 2 * (turn + mean)) : [0, 0];
  return [Math.cos(turn), Math.sin(turn), 0, 0, ...d1, ...d2, -2 * d1[0], 0, 0, spread, spread * swept[0],
    spread * swept[1], 0, 0, 0, 0];
}

/** Moments of a turn on the spot and then a run. */
export function legMoments(turn, length, curvature, noise) {
  const run = runMoments(length, curvature, noise);
  return turn === 0 ? run : compose(turnMoments(turn, noise), run);
}

/** The differential equation of elements.py, driven at `speed` (1 for runs, 0 on the spot). */
function stretch(length, curvature, headingRate, biasRate, distanceRate, lateralRate, speed, scale, correlation) {
  const fastest = Math.max(Math.abs(curvature), headingRate, Math.abs(biasRate)) * length / PIECE_RAD;
  const halvings = fastest > 1 ? Math.ceil(Math.log2(fastest)) : 0;
  const h = length / 2 ** halvings;
  const covariance = correlation * Math.sqrt(headingRate * distanceRate);
  const plain = speed === 1 && curvature === 0 && biasRate === 0 && covariance === 0 && scale === 0;
  const along = distanceRate + lateralRate, across = distanceRate - lateralRate;
  const piece = plain ? straight(h, headingRate, along, across)
    : taylorPiece(h, curvature, speed, headingRate, biasRate, scale * speed, covariance, along, across);
  const whole = doubled(piece, halvings);
  if (curvature === 0) {
    [whole[0], whole[1], whole[2], whole[3]] = [1, 0, speed * length, 0];
    return whole;
  }
  const [mr, mi] = phi(0, curvature * length);
  whole[0] = Math.cos(curvature * length);
  whole[1] = Math.sin(curvature * length);
  whole[2] = speed * length * mr;
  whole[3] = speed * length * mi;
  return whole;
}

/** A straight, unbiased piece: its series run in x = headingRate·h alone, so their coefficients are numbers. */
function straight(h, headingRate, along, across) {
  const x = headingRate * h, d1 = Math.expm1(-x / 2), hx = h * x;
  const fall = Math.expm1(-2 * x), spread = x < 1e-100 ? h : h * fall / (-2 * x);
  return [1, 0, h, 0, d1, 0, fall - 2 * d1, 0, -2 * d1, hx * horner(STRAIGHT[0], x), 0,
    h * hx * horner(STRAIGHT[1], x) + along * h, h * hx * horner(STRAIGHT[2], x) + across * spread, 0,
    hx * horner(STRAIGHT[3], x), 0, hx * horner(STRAIGHT[4], x), 0];
}

function horner(coefficients, x) {
  let total = 0;
  for (let k = coefficients.length - 1; k >= 0; k--) total = total * x + coefficients[k];
  return total;
}

function taylorPiece(h, curvature, speed, headingRate, biasRate, scale, covariance, along, across) {
  const series = taylor(h, curvature * h, speed, headingRate, biasRate, scale, covariance, along, across);
  const sum = (x) => { let total = 0; for (let k = ORDER; k >= 0; k--) total += x[k]; return total; };
  const [mr, mi] = phi(0, curvature * h);
  const s = series.map(sum);
  return [Math.cos(curvature * h), Math.sin(curvature * h), speed * h * mr, speed * h * mi, ...s];
}

/** Taylor coefficients in s/h of d1, d2, D, e1, N, e2, a, b, real and imaginary parts, in the order of a piece. */
function taylor(h, bend, speed, headingRate, biasRate, scale, covariance, along, across) {
  const mur = -headingRate / 2, mui = biasRate, dmr = -2 * headingRate, dmi = 2 * biasRate;
  const gr = scale, gi = covariance / 2;
  const rotation = (angle, k) => {  // (j angle)^k / k!
    const size = angle ** k / FACTORIAL[k];
    return [[size, 0], [0, size], [-size, 0], [0, -size]][k % 4];
  };
  const Us = [], UUs = [];
  for (let k = 0; k <= ORDER; k++) { Us.push(rotation(bend, k)); UUs.push(rotation(2 * bend, k)); }
  const times = (series, conj, xr, xi, k) => {  // coefficient k of the product of two series
    if (bend === 0) return [xr[k], xi[k]];
    let re = 0, im = 0;
    for (let i = 0; i <= k; i++) {
      const [sr, si0] = series[k - i], si = conj ? -si0 : si0;
      re += sr * xr[i] - si * xi[i];
      im += sr * xi[i] + si * xr[i];
    }
    return [re, im];
  };
  const [d1r, d1i, d2r, d2i, DD, e1r, e1i, NN, e2r, e2i, ar, ai, br, bi] = Array.from({ length: 14 }, () => [0]);
  const [m2r, m2i, ie1r, ie1i, iNr, iNi, ie2r, ie2i, iar, iai, ibr, ibi] = Array.from({ length: 12 }, () => []);
  for (let k = 0; k < ORDER; k++) {
    const one = k === 0 ? 1 : 0, rr = one + d1r[k], ri = d1i[k], step = h / (k + 1);
    m2r.push(one + 2 * d1r[k] + d2r[k]);
    m2i.push(2 * d1i[k] + d2i[k]);
    ie1r.push(speed * d1r[k] + gr * rr - gi * ri);
    ie1i.push(speed * d1i[k] + gr * ri + gi * rr);
    const ear = e1r[k] + ar[k], eai = e1i[k] + ai[k], ebr = e1r[k] + br[k], ebi = e1i[k] + bi[k];
    iNr.push(speed * ar[k] + gr * ear + gi * eai);
    iNi.push(speed * ai[k] + gr * eai - gi * ear);
    ie2r.push(speed * br[k] + gr * ebr - gi * ebi);
    ie2i.push(speed * bi[k] + gr * ebi + gi * ebr);
    const car = d1r[k] + DD[k], cai = -d1i[k], cbr = d1r[k] + d2r[k], cbi = d1i[k] + d2i[k];
    iar.push(speed * DD[k] + gr * car - gi * cai);
    iai.push(gr * cai + gi * car - covariance * one);
    ibr.push(speed * d2r[k] + gr * cbr - gi * cbi - covariance * m2i[k]);
    ibi.push(speed * d2i[k] + gr * cbi + gi * cbr + covariance * m2r[k]);
    const muRr = mur * rr - mui * ri, muRi = mur * ri + mui * rr;
    d1r.push(step * muRr);
    d1i.push(step * muRi);
    d2r.push(step * (dmr * m2r[k] - dmi * m2i[k] - 2 * muRr));
    d2i.push(step * (dmr * m2i[k] + dmi * m2r[k] - 2 * muRi));
    DD.push(step * -2 * muRr);
    const te = times(Us, false, ie1r, ie1i, k), tN = times(Us, true, iNr, iNi, k), t2 = times(Us, false, ie2r, ie2i, k);
    const tm = times(UUs, false, m2r, m2i, k), ta = times(Us, false, iar, iai, k), tb = times(Us, false, ibr, ibi, k);
    e1r.push(step * te[0]);
    e1i.push(step * te[1]);
    NN.push(step * (2 * tN[0] + one * along));
    e2r.push(step * (2 * t2[0] + across * tm[0]));
    e2i.push(step * (2 * t2[1] + across * tm[1]));
    ar.push(step * (ta[0] + mur * ear + mui * eai));
    ai.push(step * (ta[1] + mur * eai - mui * ear));
    br.push(step * (tb[0] + mur * ebr - mui * ebi));
    bi.push(step * (tb[1] + mur * ebi + mui * ebr));
  }
  return [d1r, d1i, d2r, d2i, DD, e1r, e1i, NN, e2r, e2i, ar, ai, br, bi];
}

/** Coefficients in x of e1/(h x), N/(h² x), e2/(h² x), a/(h x), b/(h x) for a straight run, no distance noise. */
const STRAIGHT = (() => {
  const series = taylor(1, 0, 1, 1, 0, 0, 0, 0, 0);
  return [[5, 2], [7, 3], [8, 3], [10, 2], [12, 2]].map(([row, first]) => series[row].slice(first));
})();
