// The moments of one turn and of one run under a noise without steps: driftplan/model/elements.py, piece by piece.
//
// A noise is an object with the fields of OdometryNoise, those that are 0 left out or not.
import { compose, D1, doubled } from "./moments.js";

const ORDER = 12, PIECE_RAD = 0.125;  // of the Taylor series; greatest rotation or heading variance on one piece
const FACTORIAL = [1];
for (let k = 1; k <= ORDER + 1; k++) FACTORIAL.push(FACTORIAL[k - 1] * k);

const RATES = ["heading_var_per_m", "distance_var_per_m", "lateral_var_per_m", "heading_var_per_rad", "distance_var_per_rad"];
export const SYSTEMATIC = ["heading_bias_per_m", "heading_bias_per_rad", "distance_scale_error"];
export const SPREADS = ["heading_bias_std_per_m", "heading_bias_std_per_rad", "distance_scale_std"];
export const NOISE_FIELDS = [...RATES, "heading_distance_corr", ...SYSTEMATIC, ...SPREADS];

/** What is known of a key, made where it is not. */
export function kept(known, key, make) {
  if (!known.has(key)) known.set(key, make());
  return known.get(key);
}

/** All fields of a noise. */
export function fullNoise(said) { return Object.fromEntries(NOISE_FIELDS.map((name) => [name, said[name] ?? 0])); }

/** The same odometry without systematic errors, `factor` times as noisy. */
export function randomPart(noise, factor) {
  const scaled = Object.fromEntries(RATES.map((name) => [name, noise[name] * factor * factor]));
  return fullNoise({ heading_distance_corr: noise.heading_distance_corr, ...scaled });
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

/** Moments of a turn on the spot (rad, positive to the left). */
function turnMoments(turn, noise) {
  const angle = Math.abs(turn), side = Math.sign(turn);
  if (noise.distance_var_per_rad !== 0 && noise.heading_distance_corr !== 0) {
    return stretch(angle, side, noise.heading_var_per_rad, noise.heading_bias_per_rad * side,
      noise.distance_var_per_rad, 0, 0, 0, noise.heading_distance_corr);
  }
  const v = noise.heading_var_per_rad * angle, spread = noise.distance_var_per_rad * angle;
  const mean = noise.heading_bias_per_rad * turn;
  const d1 = Math.expm1(-v / 2), d2 = Math.expm1(-2 * v) - 2 * d1, g = expm1(0, mean);
  const swept = spread > 0 ? phi(-2 * v, 2 * (turn + mean)) : [0, 0];
  const random = [Math.cos(turn), Math.sin(turn), 0, 0, d1, 0, d2, 0, -2 * d1, 0, 0, spread, spread * swept[0], spread * swept[1], 0, 0, 0, 0];
  return mean === 0 ? random : compose(random, [1, 0, 0, 0, ...g, ...mul(g, g), -2 * g[0], 0, 0, 0, 0, 0, 0, 0, 0, 0]);
}

/** Moments of a turn on the spot and then a straight run, rad and metres. */
export function legMoments(turn, length, noise) {
  const run = stretch(length, 0, noise.heading_var_per_m, noise.heading_bias_per_m, noise.distance_var_per_m,
    noise.lateral_var_per_m, 1, noise.distance_scale_error, noise.heading_distance_corr);
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
  if (plain) return doubled(straight(h, headingRate, along, across), halvings);
  const series = taylor(h, curvature * h, speed, headingRate, biasRate, scale * speed, covariance, along, across);
  const whole = doubled([...moved(h, curvature, speed), ...sumOf(series)], halvings);
  return [...moved(length, curvature, speed), ...whole.slice(D1)];
}

/** The true rotation and translation of an arc. */
function moved(length, curvature, speed) {
  const [re, im] = phi(0, curvature * length);
  return [Math.cos(curvature * length), Math.sin(curvature * length), speed * length * re, speed * length * im];
}

/** The errors of a piece, from their Taylor coefficients. */
function sumOf(series) {
  const [d1, d2, D, e1, N, e2, a, b] = series.map((terms) => terms.reduceRight((sum, term) => add(sum, term)));
  return [...d1, ...d2, D[0], ...e1, N[0], ...e2, ...a, ...b];
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

const add = (...terms) => terms.reduce(([x, y], [u, v]) => [x + u, y + v]);
const times = (k, [x, y]) => [k * x, k * y];
const mul = ([x, y], [u, v]) => [x * u - y * v, x * v + y * u];
const conj = ([x, y]) => [x, -y];

/** Taylor coefficients in s/h of d1, d2, D, e1, N, e2, a, b, all complex: the differential equation, order by order. */
function taylor(h, bend, speed, headingRate, biasRate, scale, covariance, along, across) {
  const mu = [-headingRate / 2, biasRate], doubleMu = [-2 * headingRate, 2 * biasRate], gamma = [scale, covariance / 2];
  const rotation = (angle, k) => {  // (j angle)^k / k!
    const size = angle ** k / FACTORIAL[k];
    return [[size, 0], [0, size], [-size, 0], [0, -size]][k % 4];
  };
  const turned = (angle, x, k) => {  // coefficient k of exp(j angle s/h) times a series
    let sum = x[k];
    for (let i = 0; i < k && angle !== 0; i++) sum = add(sum, mul(rotation(angle, k - i), x[i]));
    return sum;
  };
  const [d1, d2, D, e1, N, e2, a, b] = Array.from({ length: 8 }, () => [[0, 0]]);
  const [m2, inE1, inN, inE2, inA, inB] = Array.from({ length: 6 }, () => []);  // what the rotation multiplies
  for (let k = 0; k < ORDER; k++) {
    const one = [k === 0 ? 1 : 0, 0], r = add(one, d1[k]), muR = mul(mu, r), step = h / (k + 1);
    const ea = add(e1[k], a[k]), eb = add(e1[k], b[k]);
    m2.push(add(one, times(2, d1[k]), d2[k]));
    inE1.push(add(times(speed, d1[k]), mul(gamma, r)));
    inN.push(add(times(speed, a[k]), mul(conj(gamma), ea)));
    inE2.push(add(times(speed, b[k]), mul(gamma, eb)));
    inA.push(add(times(speed, D[k]), mul(gamma, add(conj(d1[k]), D[k])), [0, -covariance * one[0]]));
    inB.push(add(times(speed, d2[k]), mul(gamma, add(d1[k], d2[k])), mul([0, covariance], m2[k])));
    d1.push(times(step, muR));
    d2.push(times(step, add(mul(doubleMu, m2[k]), times(-2, muR))));
    D.push([-2 * step * muR[0], 0]);
    e1.push(times(step, turned(bend, inE1, k)));
    N.push([step * (2 * turned(-bend, inN, k)[0] + one[0] * along), 0]);
    e2.push(times(step, add(times(2, turned(bend, inE2, k)), times(across, turned(2 * bend, m2, k)))));
    a.push(times(step, add(turned(bend, inA, k), mul(conj(mu), ea))));
    b.push(times(step, add(turned(bend, inB, k), mul(mu, eb))));
  }
  return [d1, d2, D, e1, N, e2, a, b];
}

/** Coefficients in x of e1/(h x), N/(h² x), e2/(h² x), a/(h x), b/(h x) for a straight run, no distance noise. */
const STRAIGHT = taylor(1, 0, 1, 1, 0, 0, 0, 0, 0).slice(3).map((terms, k) => terms.slice([2, 3, 3, 2, 2][k]).map(([x]) => x));
