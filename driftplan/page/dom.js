// Elements of the page. Text is only ever set as text: names from files are shown, never run.

const SVG = "http://www.w3.org/2000/svg";
export const CURVE_PIXELS = 4;  // between points of a drawn curve

/** An element with attributes, listeners (functions under names such as onclick) and children. */
export function el(tag, attributes = {}, ...children) { return filled(document.createElement(tag), attributes, children); }

export function button(text, onclick, attributes = {}) { return el("button", { type: "button", onclick, ...attributes }, text); }

export function svg(tag, attributes = {}, ...children) { return filled(document.createElementNS(SVG, tag), attributes, children); }

function filled(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else if (value !== null && value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat().filter((child) => child !== null));
  return element;
}

export function metres(x, digits = 3) { return Number.isFinite(x) ? `${x.toFixed(digits)} m` : "–"; }

/** A round number next to x: the first of the steps, times a power of ten, that `fits` it. */
export function roundNumber(x, steps, fits = (step) => step >= x * (1 - 1e-9)) {
  const power = 10 ** Math.floor(Math.log10(x));
  return power * steps.find((step) => fits(step * power));
}

/** Hand a text, or bytes, to the browser to save. */
export function save(name, content) {
  const url = URL.createObjectURL(new Blob([content])), link = el("a", { href: url, download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
}

/** Stroke a line through places of a canvas. */
export function stroked(pen, places) {
  pen.beginPath();
  for (const [x, y] of places) pen.lineTo(x, y);
  pen.stroke();
}

/** Give a view with a `node` and its canvases their size in pixels of the page, and as many of their own as the screen has. */
export function resized(view, ...canvases) {
  const { width, height } = view.node.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  if (!(width > 0 && height > 0)) return;
  for (const canvas of canvases) {
    [canvas.width, canvas.height] = [width, height].map((size) => Math.round(size * ratio));
    canvas.getContext("2d").setTransform(ratio, 0, 0, ratio, 0, 0);
  }
  const least = window.matchMedia("(pointer: coarse)").matches ? 1.6 : 1;  // for fingers; and letters grow with a screen
  Object.assign(view, { width, height, drawnStill: [], unit: Math.max(least, Math.sqrt(width / 1500)) });
}
