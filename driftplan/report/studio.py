"""What stands behind the page of `driftplan.page` while Python runs: answers in JSON to what the page asks (the fewest
beacons, routes, files that are no plain text), a server on the loopback address, and the page in a notebook."""

from __future__ import annotations

import csv
import io
import json
import secrets
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from driftplan.arrays import positive
from driftplan.beacons.beacon import Beacon, BeaconKind
from driftplan.beacons.beacon_files import beacons_geojson, load_beacons
from driftplan.beacons.readings import waypoints_of
from driftplan.errors import DriftplanError, InfeasibleError
from driftplan.files import write_files
from driftplan.layouts.layout import Layout
from driftplan.layouts.layout_files import InstallerRow, layout_building, layout_dxf, layout_html, layout_lif
from driftplan.layouts.place import place_beacons
from driftplan.layouts.scenario import Scenario, Sites
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Estimator, Fix
from driftplan.page.scene import Scene, beacon_of, beacon_said, page, scene_of, script, style, zones_of
from driftplan.planning.routes import plan_route
from driftplan.planning.status import Status
from driftplan.report.commands.answer import figure_bytes
from driftplan.report.figures.layouts import layout_figure
from driftplan.report.figures.sheet import layout_pdf
from driftplan.world.route_files import read_path
from driftplan.world.world import World

_OF_BEACONS = (".geojson", ".json", ".lif", ".dxf", ".txt", ".building.yaml")
_WRITERS: dict[str, Callable[[Layout], bytes]] = {
    "beacons.dxf": layout_dxf,
    "layout.lif": layout_lif,
    "sheet.pdf": layout_pdf,
    "table.html": layout_html,
    "layout.svg": lambda layout: figure_bytes(layout_figure(layout), "svg"),
}
_MAX_BYTES = 64 << 20  # of a question
_AT_ONCE_S = 0.05  # to plan a first route, while a better one is looked for


@dataclass(frozen=True, kw_only=True)
class Answers:
    """Answers about one world, with ``time_limit`` seconds for a search; the scene that is asked about brings all
    else. ``save`` is where its beacons may be written, None: nowhere. ``building`` is the map, where it is an Open-RMF
    building, and its level."""

    world: World | None
    time_limit: float = 60.0
    save: Path | None = None
    building: tuple[Path, str | None] | None = None
    _worlds: list[tuple[Any, World]] = field(default_factory=list, init=False, repr=False)  # the last floors' world

    def __post_init__(self) -> None:
        positive("time_limit", self.time_limit)

    def answer(self, what: str, question: dict[str, Any], tell: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
        """``{"answer": …}``, or ``{"error": text}``; ``tell`` hears of progress.

        "fewest": beacons; "why": the stretch that cannot be kept; "plan": routes; "save": the beacons to `save`;
        "write": the bytes of a file, each as a character; "read": what the text of a file changes.
        """
        try:
            scene = question["scene"]
            scenario = self._scenario(scene)
            if what in ("fewest", "why"):
                kind = BeaconKind(**question["kind"])
                return {"answer": self._fewest(scene, scenario, kind, tell, why=what == "why")}
            if what == "read":
                kind = BeaconKind(**question["kind"])
                return {"answer": _read(str(question["name"]), str(question["text"]), scene, kind)}
            if what == "write":
                file = self._written(str(question["name"]), _layout(scene, scenario))
                return {"answer": {"bytes": file.decode("latin-1")}}
            if what == "plan" and scenario.world is not None:
                plan = partial(_plan, scenario, _alive(scene), question["start"], question["goal"])
                with suppress(DriftplanError):  # the long search says what is wrong
                    tell(plan(_AT_ONCE_S))
                return {"answer": plan(None)}
            if what == "save" and self.save is not None:
                write_files({self.save: beacons_geojson(_alive(scene))})
                return {"answer": {"message": f"wrote {self.save}"}}
            return {"error": f"expected a question about a map or a file that is there, got {what!r}"}
        except (DriftplanError, ValueError, KeyError, TypeError, OSError) as err:
            return {"error": str(err) or type(err).__name__}

    def _scenario(self, scene: Scene) -> Scenario:
        routes, start = tuple(np.array(route["points"]) for route in scene["routes"]), scene["start_fix"]
        fix = None if start is None else Fix(s_m=0.0, **start)
        noise, world = OdometryNoise(**scene["noise"]), self._on(scene["zones"])
        return Scenario(world, routes, noise, start_fix=fix, estimator=scene["estimator"])

    def _on(self, zones: list[dict[str, Any]]) -> World | None:
        """The world with these floors; the same object for the same floors: a world keeps what was planned on it."""
        if self.world is None:
            return None
        known = self._worlds[:]  # of this question: others may be answered meanwhile
        if not known or known[0][0] != zones:
            self._worlds[:] = known = [(zones, replace(self.world, zones=zones_of({"zones": zones})))]
        return known[0][1]

    def _fewest(
        self, scene: Scene, scenario: Scenario, kind: BeaconKind, tell: Callable[..., None], *, why: bool
    ) -> dict[str, Any]:
        """What is locked or was there before stays, everything else is placed anew; of ``why`` only until it is known
        that the limits can be kept."""
        kept = [one for one in scene["beacons"] if one.get("existing") or one.get("locked")]
        limits = [route["limit_m"] for route in scene["routes"]]
        if None in limits:
            raise ValueError("expected a limit for every route: set the limit of all")
        alive = [beacon_of(one) for one in kept if not one.get("dead")]

        def heard(_: float, cost: float, bound: float) -> None:
            if why and isfinite(cost):
                raise _CanBeKept(f"The limits can be kept, at a cost of {cost:g}; at least {bound:g} is needed.")
            tell({"cost": cost if isfinite(cost) else None, "bound": bound})

        try:
            robot: dict[str, Any] = {"estimator": scenario.estimator, "start_fix": scenario.start_fix}
            asked = (scenario.world, scenario.routes, scenario.noise, limits, _sites(scene, kind, alive))
            found = place_beacons(*asked, time_limit=self.time_limit, progress=heard, **robot)
        except _CanBeKept as err:
            return {"message": str(err)}
        except InfeasibleError as err:
            return {"infeasible": str(err), **({} if err.stretch is None else err.stretch._asdict())}
        words = f"{len(found.beacons)} new, at least {found.lower_bound:g} needed; greatest drift"
        message = f"{words} {found.worst_drift:.3g} m. {found.note}"
        return {"beacons": [*kept, *map(beacon_said, found.beacons)], "proven": found.proven, "message": message}

    def _written(self, name: str, layout: Layout) -> bytes:
        """The file of a layout that has this name."""
        if name == "site.building.yaml" and self.building is not None:
            return layout_building(layout, self.building[0], level=self.building[1])
        if name not in _WRITERS:
            raise ValueError(f"expected {', '.join(_WRITERS)}, or site.building.yaml where that is the map, got {name}")
        return _WRITERS[name](layout)


class _CanBeKept(Exception):
    """A search need not go on."""


def _sites(scene: Scene, kind: BeaconKind, existing: list[Beacon]) -> Sites:
    """The candidates, beacons or places for a kind; a grid where there are none."""
    sites = scene["sites"]
    if sites and "kind" in sites[0]:
        return Sites(points=[*map(beacon_of, sites)], existing=existing)
    return Sites(kind, [(one["x"], one["y"]) for one in sites] or None, existing=existing)


def _layout(scene: Scene, scenario: Scenario) -> Layout:
    """The beacons that are alive, as a layout of which nothing is proven; a limit that they break is no limit of it."""
    new, existing = _alive(scene, existing=False), _alive(scene, existing=True)
    drifts = tuple(scenario.drift(r, (*existing, *new)) for r in range(len(scenario.routes)))
    limits = [route["limit_m"] or 0.0 for route in scene["routes"]]
    return Layout(
        beacons=new,
        existing=existing,
        cost=sum(beacon.kind.cost for beacon in new),
        lower_bound=0.0,
        proven=False,
        status=Status.TIME_LIMIT,
        max_drift=tuple(max(limit, scenario.worst(drift)) for limit, drift in zip(limits, drifts, strict=True)),
        drift_bound=0.0,
        drifts=drifts,
        seconds=0.0,
        scenario=scenario,
    )


def _plan(
    scenario: Scenario, beacons: Sequence[Beacon], start: Any, goal: Any, time_limit: float | None
) -> dict[str, Any]:
    """The route of least drift and the shortest one, with the beacons that are alive."""
    world: Any = scenario.world
    ends, found = (world.nearest_free(start), world.nearest_free(goal)), []
    robot: dict[str, Any] = {"estimator": scenario.estimator, "start_fix": scenario.start_fix}
    route = plan_route(world, *ends, scenario.noise, beacons=beacons, time_limit=time_limit, **robot)
    for name, one in (("least drift", route), ("shortest", route.shortest)):
        if one is not None:
            rms = float(replace(scenario, routes=(one.path,)).drift(0, beacons).end.rms)
            found.append({"name": name, "points": one.path.tolist(), "length_m": one.length, "rms_m": rms})
    return {"routes": found}


def _alive(scene: Scene, *, existing: bool | None = None) -> tuple[Beacon, ...]:
    """The beacons that are not dead; with ``existing`` those that were there before, or the others."""
    living = [one for one in scene["beacons"] if not one.get("dead")]
    return tuple(beacon_of(one) for one in living if existing in (None, bool(one.get("existing"))))


def _read(name: str, text: str, scene: Scene, kind: BeaconKind) -> dict[str, Any]:
    """What a file changes in a scene: its beacons, or one more route. ``kind`` is that of beacons that say none."""
    if text.startswith(",".join(InstallerRow._fields[:4])):
        return {"beacons": _as_built(text, scene, kind)}
    with TemporaryDirectory() as folder:
        file = Path(folder, Path(name).name)
        file.write_text(text, encoding="utf-8")
        try:
            if file.name.lower().endswith(_OF_BEACONS) or "tag_bundles" in text:
                return {"beacons": [*map(beacon_said, load_beacons(file, kind))]}
            points = read_path(file)[:, :2].tolist()
        except DriftplanError as err:
            raise ValueError(str(err).replace(f"{folder}/", "")) from err
    limits = [route["limit_m"] for route in scene["routes"]]
    return {"routes": [*scene["routes"], {"name": name, "points": points, "limit_m": limits[0] if limits else None}]}


def _as_built(text: str, scene: Scene, kind: BeaconKind) -> list[dict[str, Any]]:
    """Beacons of an installers' table, which says where they are: those that the scene knows, by their ids, keep what
    they are; others are of a kind of that name in the scene, or of ``kind``."""
    known, found = {one["id"]: one for one in scene["beacons"]}, []
    kinds = {one["kind"]["name"]: beacon_of(one).kind for one in scene["beacons"]}
    for line, row in enumerate(csv.DictReader(io.StringIO(text)), start=2):
        try:
            own = known.get(row["id"])
            of_kind = kinds.get(row["kind"], kind) if own is None else beacon_of(own).kind
            facing = float(row["facing_deg"]) if row["facing_deg"] else None
            beacon = Beacon(of_kind, float(row["x_m"]), float(row["y_m"]), id=row["id"], facing_deg=facing)
        except (KeyError, TypeError, ValueError) as err:
            raise ValueError(f"line {line}: expected a row of an installers' table: {err}") from err
        kept = {key: own[key] for key in ("locked", "dead") if key in own} if own else {}
        found.append({**beacon_said(beacon, existing=row.get("new") == "False"), **kept})
    return found


class StudioServer(ThreadingHTTPServer):
    """Serves one page at `url` and answers what it asks; no file of this machine is ever sent.

    Whoever does not know the token in the URL gets nothing, and what another site's page sends is refused.
    """

    daemon_threads = True  # a search does not outlive the command

    def __init__(self, scene: Scene, answers: Answers, port: int = 0):
        super().__init__(("127.0.0.1", port), _Requests)
        self.answers, self.page = answers, page(scene, asks=True, saves=answers.save is not None)
        self.root = f"/{secrets.token_urlsafe(24)}/"
        self.url = f"http://127.0.0.1:{self.server_port}{self.root}"


class _Requests(BaseHTTPRequestHandler):
    server: StudioServer

    def do_GET(self) -> None:
        if self._is_ours(self.path):
            self._send(200, "text/html; charset=utf-8", self.server.page)
        else:
            self._send(404, "text/plain", b"nothing here")

    def do_POST(self) -> None:
        """Answers with lines of JSON: progress, then the answer or an error. A page that hangs up ends the search."""
        root, _, what = self.path.partition("ask/")
        is_json = self.headers.get("Content-Type") == "application/json"  # a form of another site cannot send that
        size = self.headers.get("Content-Length", "")
        if not (self._is_ours(root) and is_json and size.isdecimal() and int(size) <= _MAX_BYTES):
            return self._send(404, "text/plain", b"nothing here")
        try:
            question = json.loads(self.rfile.read(int(size)))
        except (ValueError, RecursionError):
            return self._send(400, "text/plain", b"expected JSON")
        self._send(200, "application/x-ndjson")
        return self._line(self.server.answers.answer(what, question, lambda news: self._line({"progress": news})))

    def _line(self, message: dict[str, Any]) -> None:
        self.wfile.write(json.dumps(message).encode() + b"\n")

    def _is_ours(self, path: str) -> bool:
        """Whether the token is there, and the browser knows whom it talks to: no name that someone points here."""
        hosts = [f"{name}:{self.server.server_port}" for name in ("127.0.0.1", "localhost")]
        return secrets.compare_digest(path.encode(), self.server.root.encode()) and self.headers.get("Host") in hosts

    def _send(self, status: int, kind: str, body: bytes = b"") -> None:
        """The answer, or the beginning of one that goes on until the connection ends (HTTP/1.0)."""
        self.send_response(status)
        headers = {"Content-Type": kind, "Cache-Control": "no-store", "X-Content-Type-Options": "nosniff"}
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def handle(self) -> None:
        try:
            super().handle()
        except (BrokenPipeError, ConnectionResetError):
            self.close_connection = True  # it hung up

    def log_message(self, *_: object) -> None:
        """Nothing: the URL holds the token."""


def studio_widget(
    world: World | None,
    routes: Sequence[Any],
    noise: OdometryNoise,
    *,
    beacons: Sequence[Beacon] = (),
    max_drift: float | None = None,
    estimator: Estimator = "reset",
    time_limit: float = 60.0,
) -> Any:
    """A studio in a notebook's cell, with Python behind it: ``.beacons`` is what was made in it, as a tuple of Beacon.

    Parameters
    ----------
    world, routes, noise, beacons, estimator : as for `place_beacons` and `drift_with_beacons`
    max_drift : the limit of every route, metres; None: there is none yet
    time_limit : seconds for a search that is asked for in the studio

    Raises ImportError without anywidget: ``pip install 'driftplan[notebook]'``.

    >>> from driftplan import BeaconKind
    >>> tag = Beacon(BeaconKind.rfid(range_m=1.5, position_std_m=0.1), x=3.0, y=0.0, id="A7")
    >>> studio_widget(None, [[(0, 0), (10, 0)]], OdometryNoise(heading_var_per_m=1e-3), beacons=[tag]).beacons == (tag,)
    True
    """
    try:
        from anywidget import AnyWidget
        from traitlets import Dict
    except ImportError:
        raise ImportError("studio_widget needs anywidget: pip install 'driftplan[notebook]'") from None
    paths = [waypoints_of(route) for route in routes]
    limits = [max_drift] * len(paths)
    scene = scene_of(world, paths, noise, beacons=beacons, limits=limits, estimator=estimator)
    answers = Answers(world=world, time_limit=time_limit)

    class StudioWidget(AnyWidget):  # type: ignore[misc]
        _esm = f"{script()}\nexport default {{ render }};\n"
        _css = style()
        scene = Dict().tag(sync=True)

        @property
        def beacons(self) -> tuple[Beacon, ...]:
            return tuple(beacon_of(one) for one in self.scene["beacons"] if not one.get("dead"))

    stopped: set[Any] = set()  # questions whose answers nobody waits for

    def answer(widget: Any, message: dict[str, Any]) -> None:
        known = {"id": message.get("id")}

        def tell(news: dict[str, Any]) -> None:
            if known["id"] in stopped:
                raise ConnectionAbortedError("stopped")
            widget.send({**known, "progress": news})

        widget.send({**known, **answers.answer(str(message.get("what")), message.get("question", {}), tell)})

    def hear(widget: Any, message: dict[str, Any], _: Any) -> None:
        if message.get("what") == "stop":
            stopped.add(message.get("id"))
        else:
            threading.Thread(target=answer, args=(widget, message), daemon=True).start()

    widget = StudioWidget(scene=scene)
    widget.on_msg(hear)
    return widget
