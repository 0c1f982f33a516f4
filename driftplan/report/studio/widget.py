"""The page of `driftplan.page` in a notebook: Jupyter, VS Code, marimo."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

from driftplan.beacons.beacon import Beacon
from driftplan.beacons.readings import waypoints_of
from driftplan.model.noise import OdometryNoise
from driftplan.model.readings import Estimator
from driftplan.page.scene import beacon_of, scene_of, script, style
from driftplan.report.studio.answers import Answers
from driftplan.world.world import World


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
