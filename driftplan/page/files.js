// The files that `driftplan place` reads and writes, in the page: beacons and floors as GeoJSON, routes as CSV, noise as
// YAML; and the state of the page in a link.
import { NOISE_FIELDS } from "./elements.js";
import { KIND_NAMES, usualKind } from "./session.js";

export const ABOUT = "# driftplan file version 1, frame map, metres\n";
const CRS = { type: "name", properties: { name: 'LOCAL_CS["map frame",UNIT["metre",1]]' } };
const MEASURED = ["position_std_m", "heading_std", "range_std_m", "bearing_std"];
const KIND_FIELDS = ["range_m", ...MEASURED, "detection_probability", "line_of_sight", "reading_spacing_m", "cost", "std_per_m",
  "view_angle_deg", "sensor_view_deg"];

function expect(holds, what) { if (!holds) throw new Error(`expected ${what}`); }

/** Beacons as `driftplan place --geojson` writes them; dead ones are left out. */
export function beaconsAsGeojson(beacons) {
  const features = beacons.filter(({ dead }) => !dead).map(({ id, x, y, facing_deg, kind, existing }) => {
    const { name, ...fields } = kind, said = Object.entries(fields).filter(([, value]) => (value ?? null) !== null);
    const facing = (facing_deg ?? null) === null ? {} : { facing_deg };
    return { type: "Feature", geometry: { type: "Point", coordinates: [x, y] },
      properties: { id, kind: name, ...Object.fromEntries(said), ...facing, new: !existing } };
  });
  return collection(features);
}

function collection(features) {
  const lines = features.map((feature) => JSON.stringify(feature)).join(",\n");
  return `{"type": "FeatureCollection", "crs": ${JSON.stringify(CRS)}, "driftplan": {"version": 1, "frame": "map"}, "features": [\n${lines}\n]}\n`;
}

function featuresOf(text) {
  const said = JSON.parse(text);
  expect(Array.isArray(said?.features), "a GeoJSON FeatureCollection of beacons or floors");
  expect(!/CRS84|4326/.test(JSON.stringify(said.crs ?? "")), "coordinates in metres, got degrees");
  return said.features;
}

/** Floors as `driftplan place --zones` reads them, within the map's bounds. */
export function zonesAsGeojson(zones, [left, low, right, high]) {
  const feature = (coordinates, properties) => ({ type: "Feature", geometry: { type: "MultiPolygon", coordinates }, properties });
  const whole = [[[[left, low], [right, low], [right, high], [left, high], [left, low]]]];
  return collection([feature(whole, { kind: "boundary" }), ...zones.map(({ polygons, noise }) => feature(polygons, { kind: "zone", heading_var_per_m: 0, ...noise }))]);
}

/** Floors of such a file; there may be none. */
export function zonesFromGeojson(text) {
  return featuresOf(text).filter((feature) => feature?.properties?.kind === "zone").map(({ geometry, properties }, k) => {
    const { type, coordinates } = geometry ?? {}, polygons = type === "Polygon" ? [coordinates] : coordinates;
    const list = (least, holds) => (some) => Array.isArray(some) && some.length >= least && some.every(holds);
    expect(/Polygon$/.test(type) && list(1, list(1, list(4, list(2, Number.isFinite))))(polygons), `floor ${k + 1} to be polygons in metres`);
    const noise = Object.fromEntries(Object.entries(properties).filter(([name]) => name !== "kind" && name !== "name"));
    expect(Object.keys(noise).length, `the noise of floor ${k + 1}, such as heading_var_per_m`);
    return { polygons, noise: noiseFromYaml(noiseAsYaml(noise)) };
  });
}

/** Beacons of such a file; an Error says what is wrong with it. */
export function beaconsFromGeojson(text) {
  const features = featuresOf(text), found = features.flatMap((feature, k) => {
    if (feature?.geometry?.type !== "Point") return [];
    const { id, kind, facing_deg = null, new: added, ...rest } = feature.properties ?? {}, where = `of feature ${k + 1}`;
    const [x, y] = feature.geometry.coordinates ?? [], fields = {};
    expect(Number.isFinite(x) && Number.isFinite(y), `coordinates ${where} to be [x, y] in metres`);
    for (const [name, value] of KIND_FIELDS.map((one) => [one, rest[one] ?? null]).filter(([, held]) => held !== null)) {
      const usable = name === "line_of_sight" ? typeof value === "boolean" : Number.isFinite(value) && value >= 0;
      expect(usable, `${name} ${where} to be ${name === "line_of_sight" ? "true or false" : "a number of 0 or more"}, got ${JSON.stringify(value)}`);
      fields[name] = value;
    }
    expect(fields.range_m > 0 && MEASURED.some((name) => name in fields), `range_m and what is measured (${MEASURED.join(", ")}) ${where}`);
    expect(facing_deg === null ? !(fields.view_angle_deg < 360) : Number.isFinite(facing_deg),
      `facing_deg ${where} in degrees, and with a view_angle_deg, got ${JSON.stringify(facing_deg)}`);
    const { range_m: _, position_std_m: __, ...common } = usualKind(KIND_NAMES[0]);
    return { id: String(id ?? ""), x, y, facing_deg, existing: added === false,
      kind: { ...common, ...fields, name: String(kind ?? "beacon") } };
  });
  expect(found.length || !features.length, "at least one Point feature that is a beacon");
  return found;
}

/** A noise as `driftplan fit --yaml` writes it. */
export function noiseAsYaml(noise) {
  const lines = Object.entries(noise).filter(([, value]) => value !== 0).map(([key, value]) => {
    const text = String(value);  // YAML 1.1 takes 1e-4 for text
    return `${key}: ${text.includes("e") && !text.includes(".") ? text.replace("e", ".0e") : text}`;
  });
  return `# driftplan file version 1, frame of the robot, metres\n# Noise of an odometry for driftplan, in SI units and radians.\n${lines.join("\n") || "{}"}\n`;
}

export function noiseFromYaml(text) {
  const noise = {};
  for (const line of text.split(/\r?\n/)) {
    const words = line.replace(/#.*/, "").trim();
    if (!words || words === "{}" || words === "---") continue;
    const [, key, value] = /^(\w+):\s*(\S+)$/.exec(words) ?? [];
    expect(key !== "step_m", "rates per metre: noise per step (step_m) cannot be computed with here");
    expect(NOISE_FIELDS.includes(key) && Number.isFinite(Number(value)), `lines such as heading_var_per_m: 1.0e-4, got ${JSON.stringify(words.slice(0, 60))}`);
    noise[key] = Number(value);
  }
  expect(!NOISE_FIELDS.some((name) => /_var_|_std/.test(name) && noise[name] < 0), "variances of 0 or more");
  return noise;
}

export function routeAsCsv({ points }) { return `${ABOUT}x,y\n${points.map((xy) => xy.join(",")).join("\n")}\n`; }

export function routeFromCsv(text, least = 2) {
  const rows = text.split(/\r?\n/).map((line) => line.trim()).filter((line) => line && !line.startsWith("#"));
  const points = rows.map((row) => row.split(/[,;\s]+/).slice(0, 2).map(Number));
  if (/^["']?x["']?\s*[,;\s]\s*["']?y["']?([,;\s]|$)/i.test(rows[0])) points.shift();  // other columns and units are not guessed
  const usable = points.length >= least && points.every((xy) => xy.length === 2 && xy.every(Number.isFinite));
  expect(usable, `x,y in metres, one place per line, ${least} at least`);
  return points;
}

const EDITED = ["noise", "routes", "beacons", "zones", "sites", "estimator"];  // all that a link holds: no walls

export function asLink(scene) {
  const state = Object.fromEntries(EDITED.map((key) => [key, scene[key]]));
  const bytes = new TextEncoder().encode(JSON.stringify(state));
  return `#state=${btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join("")).replace(/\+/g, "-").replace(/\//g, "_")}`;
}

/** The scene with the state of a link, or as it is where the link has none that makes sense. */
export function withLink(scene, hash) {
  try {
    const [, code] = /^#state=([\w=-]+)$/.exec(hash);
    const bytes = Uint8Array.from(atob(code.replace(/-/g, "+").replace(/_/g, "/")), (char) => char.charCodeAt(0));
    const state = JSON.parse(new TextDecoder().decode(bytes));
    beaconsFromGeojson(beaconsAsGeojson(state.beacons));  // these throw what makes no sense
    zonesFromGeojson(zonesAsGeojson(state.zones, scene.bounds));
    noiseFromYaml(noiseAsYaml(state.noise));
    for (const route of state.routes) routeFromCsv(routeAsCsv(route));
    const known = ["reset", "filter"].includes(state.estimator) && state.sites.every(({ x, y }) => Number.isFinite(x + y));
    return known ? { ...scene, ...Object.fromEntries(EDITED.map((key) => [key, state[key]])) } : scene;
  } catch {
    return scene;
  }
}
