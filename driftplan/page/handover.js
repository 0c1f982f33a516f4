// What `driftplan place` writes for those who put beacons up and for the detectors of ROS: driftplan/layouts/layout.py
// and driftplan/beacons/beacon_files.py. Beacons that are dead are left out.
import { ABOUT, beaconsAsGeojson, noiseAsYaml, routeAsCsv, zonesAsGeojson } from "./files.js";

const TAG_SIZE_M = 0.16, HALF_DEG = Math.PI / 360;
const HEAD = "id,kind,x_m,y_m,facing_deg,new,nearest_wall_m,wall_x_m,wall_y_m,routes,worst_drift_if_dead_m,worst_route_if_dead,frame,version";

/** Files by their names: each makes its text of a studio. */
export const WRITTEN = {
  "beacons.geojson": ({ session }) => beaconsAsGeojson(session.scene.beacons),
  "route.csv": ({ session }) => routeAsCsv(session.route ?? { points: [] }),
  "noise.yaml": ({ session }) => noiseAsYaml(session.scene.noise),
  "floors.geojson": ({ session }) => zonesAsGeojson(session.scene.zones, session.scene.bounds),
  "installers.csv": installersTable,
  "tags.yaml": ofTags(`${ABOUT}standalone_tags: []\ntag_bundles:\n- name: map\n  layout:\n`, ({ tag, x, y, deg }) =>
    `    - {id: ${tag}, size: ${TAG_SIZE_M}, x: ${decimal(x)}, y: ${decimal(y)}, z: 0.0, qw: ${decimal(Math.cos(deg * HALF_DEG))}, `
    + `qx: 0.0, qy: 0.0, qz: ${decimal(Math.sin(deg * HALF_DEG))}}\n`, ""),
  "map.txt": ofTags("", ({ tag, x, y, deg, variance }) => `${tag} ${[x, y, 0, 0, 0, deg, variance].map((c) => c.toFixed(6)).join(" ")} 1\n`, ""),
  "transforms.sh": ofTags(`#!/bin/sh\n${ABOUT}`, ({ tag, x, y, deg }) => `ros2 run tf2_ros static_transform_publisher --x ${decimal(x)} `
    + `--y ${decimal(y)} --yaw ${decimal(deg * 2 * HALF_DEG)} --frame-id map --child-frame-id tag_${tag} &\n`, "wait\n"),
};

/** Files that Python writes. */
export const DRAWN = ["beacons.dxf", "layout.svg", "sheet.pdf", "table.html", "layout.lif", "site.building.yaml"];

/** A number as Python writes it. */
function decimal(x, digits = 6) {
  const rounded = Number(x.toFixed(digits)) + 0;  // no minus before a zero
  return Number.isInteger(rounded) ? rounded.toFixed(1) : String(rounded);
}

/** A file with a line for each tag. Tags' numbers are the digits that ids end in, if all have some and no two the same. */
function ofTags(begin, line, end) {
  return ({ session }) => {
    const alive = session.scene.beacons.filter(({ dead }) => !dead);
    const numbers = alive.flatMap(({ id }) => (/\d{1,9}$/.exec(id) ?? []).map(Number)), apart = new Set(numbers).size === alive.length;
    return begin + alive.map(({ x, y, facing_deg: facing, kind }, k) => line(
      { tag: apart ? numbers[k] : k, x, y, deg: facing ?? 0, variance: (kind.position_std_m ?? 0) ** 2 })).join("") + end;
  };
}

/** One row per beacon, the one whose failure hurts most first. */
function installersTable({ session: { scene }, calculator }) {
  const alive = scene.beacons.filter(({ dead }) => !dead), cell = (x) => (Number.isFinite(x) ? decimal(x, 4) : "");
  const quoted = (text) => (/[",\r\n]/.test(text) ? `"${text.replace(/"/g, '""')}"` : text);
  const rows = alive.map((beacon) => {
    const { id, kind, x, y, facing_deg: facing, existing } = beacon, others = alive.filter((one) => one !== beacon);
    const routes = [...scene.routes.keys()].filter((k) => calculator.readingsOn(scene.routes[k], beacon).length);
    const without = routes.map((k) => calculator.drift({ ...scene, beacons: others }, scene.routes[k]).worst), worst = Math.max(...without);
    const [wx, wy] = calculator.walls.nearest(x, y, Infinity) ?? [NaN, NaN];
    const cells = [quoted(id), quoted(kind.name), cell(x), cell(y), cell(facing ?? NaN), existing ? "False" : "True",
      ...[Math.hypot(wx - x, wy - y), wx, wy].map(cell), routes.join(" "), cell(worst), routes[without.indexOf(worst)] ?? -1, "map", 1];
    return { worst: routes.length ? worst : 0, line: cells.join(",") };
  });
  return [HEAD, ...rows.sort((one, other) => other.worst - one.worst).map(({ line }) => line), ""].join("\n");
}
