"""Zone files: floors of other noise, drawn on a map of any format.

Either a GeoJSON map, whose zones are taken and nothing else (`driftplan.world.geojson_map`), or a raster: a YAML file
placed like a ROS map, which says what the greys of its picture mean::

    image: floor.png            # beside this file; grey, 8 or 16 bits
    resolution: 0.1             # metres per pixel
    origin: [0.0, 0.0, 0.0]     # x, y, yaw of the lower left corner
    zones:
      100: {heading_var_per_m: 1.0e-3}                             # pixels of the value 100: a wet floor
      200: {heading_var_per_m: 2.0e-4, distance_var_per_m: 1.0e-3}

Pixels of other values are no zone. What map_server says of a picture (negate, mode, thresholds) may stand beside: a
speed mask of nav2's, with the key zones added, is a zone file.
"""

from __future__ import annotations

import os
from pathlib import Path
from reprlib import repr as short

import numpy as np

from driftplan.errors import MapError, naming
from driftplan.world.cells import area_of_cells
from driftplan.world.formats import Format, format_of
from driftplan.world.geojson_map import read_geojson_map, zone_noise
from driftplan.world.ros_map import RULE_KEYS, read_header, read_pixels
from driftplan.world.zones import Zone

_MOST_ZONES = 64  # each is cut out of every path


def load_zones(path: str | os.PathLike[str], *, origin: tuple[float, float] | None = None) -> tuple[Zone, ...]:
    """The zones of a GeoJSON map or of a raster, for `World`; `load_world` takes the file's name too.

    Parameters
    ----------
    path : path of a ``.geojson``, ``.json``, ``.yaml`` or ``.yml`` file, as the module's docstring says
    origin : (longitude, latitude), of GeoJSON in degrees, as for `load_world`

    Raises MapError if the file is missing, broken or without zones, or names a grey that its picture does not have.

    >>> from driftplan.world.mapfiles import bundled_map
    >>> [zone.polygon.area > 50 for zone in load_zones(bundled_map("office"))]
    [True]
    """
    path = Path(path)
    form = format_of(path, FORMATS, "zones")
    zones: tuple[Zone, ...] = form.read(path, **({"origin": origin} if "origin" in form.options else {}))
    if not zones:
        raise MapError(f"{path}: expected at least one zone, got none")
    return zones


def _read_raster(path: Path) -> tuple[Zone, ...]:
    picture = read_header(path, (), ("zones", *RULE_KEYS))
    pixels = read_pixels(picture.image, path, colour=False)[::-1]  # row 0 at the bottom
    listed = picture.values.get("zones")
    if not (isinstance(listed, dict) and 0 < len(listed) <= _MOST_ZONES):
        wanted = f"expected zones to give 1 to {_MOST_ZONES} greys a noise, got {short(listed)}"
        greys = f"the greys of {picture.image.name} are {short(np.unique(pixels).tolist())}"
        raise MapError(f"{path}: {wanted}: add, say, zones: {{100: {{heading_var_per_m: 1e-3}}}}; {greys}")
    zones = []
    for grey, noise in listed.items():
        where = f"{path}, zone {short(grey)}"
        if isinstance(grey, bool) or not isinstance(grey, int):
            raise MapError(f"{where}: expected a grey, a whole number such as 100")
        if not isinstance(noise, dict):
            raise MapError(f"{where}: expected its noise, such as {{heading_var_per_m: 1.0e-3}}, got {short(noise)}")
        chosen = pixels == grey
        if not chosen.any():
            raise MapError(f"{where}: no pixel of {picture.image.name} has this value")
        with naming(picture.image, MapError):
            area = area_of_cells(chosen, cell_size_m=picture.resolution, origin=picture.origin)
        zones.append(Zone(area, zone_noise(where, noise)))
    return tuple(zones)


def _read_geojson(path: Path, origin: tuple[float, float] | None) -> tuple[Zone, ...]:
    return read_geojson_map(path, robot_radius=0.0, origin=origin).zones


FORMATS = (
    Format("GeoJSON", (".geojson", ".json"), _read_geojson, options=("origin",)),
    Format("raster", (".yaml", ".yml"), _read_raster),
)
