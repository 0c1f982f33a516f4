// Colours and symbols. Drift is told by lightness within one hue, what exceeds a limit by another hue and a thicker line:
// both survive any colour blindness. Kinds of beacons differ in shape.

import { exceeds } from "./drift.js";

export const CLASSES = 8;

/** The colours of the theme that is on, read from the style sheet. */
export function themeOf(element) {
  const style = getComputedStyle(element), colour = (name) => style.getPropertyValue(`--${name}`).trim();
  const [low, high] = [colour("drift-low"), colour("drift-high")].map(rgb);
  const ramp = Array.from({ length: CLASSES }, (_, k) => mixed(low, high, k / (CLASSES - 1)));
  const names = ["wall", "zone", "zone-line", "route", "over", "text", "faint", "paper", "accent", "other"];
  return { ramp, ...Object.fromEntries(names.map((name) => [name.replace("-l", "L"), colour(name)])) };
}

function rgb(hex) { return [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16)); }
function mixed(from, to, share) { return `rgb(${from.map((x, k) => Math.round(x + share * (to[k] - x))).join(" ")})`; }

/** The class of an rms, 0 to CLASSES - 1, or CLASSES where it exceeds the limit. */
export function classOf(rms, limit, most) {
  if (exceeds(rms, limit)) return CLASSES;
  return Math.min(Math.floor(rms / Math.max(limit ?? most, 1e-12) * CLASSES), CLASSES - 1);
}

/** The outline of a beacon's symbol by what it measures, about (0, 0), 7 pixels in radius. */
export function symbolOf(kind) {
  const measures = (name) => (kind[name] ?? null) !== null;
  if (measures("position_std_m")) return measures("heading_std") ? "M-6-6H6V6H-6Z" : "M-7 0A7 7 0 1 1 7 0A7 7 0 1 1-7 0Z";
  if (measures("range_std_m")) return "M0-8L8 0L0 8L-8 0Z";
  return measures("bearing_std") ? "M0-8L7.6-2.5L4.7 6.5H-4.7L-7.6-2.5Z" : "M0-8L7 5H-7Z";
}
