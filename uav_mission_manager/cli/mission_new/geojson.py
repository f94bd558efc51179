"""Reads GeoJSON (RFC 7946): its points, polygons and lines."""

from __future__ import annotations

from collections.abc import Iterator

from uav_mission_manager.cli.mission_new.found import Found, point_of, ring_of
from uav_mission_manager.cli.mission_new.json_value import JsonValue
from uav_mission_manager.echo import shown

NAME_KEYS = ('name', 'Name', 'NAME', 'title', 'id')
"""Properties that may be a feature's name, the first that there is."""

WORLD_SYSTEMS = ('CRS84', '4326')
"""Ends of names of coordinate systems of longitude and latitude, in files older than the RFC."""

MAX_DEPTH = 20
"""Collections within collections at most: a choice."""


def read_geojson(root: JsonValue) -> Found:
    """Return what a GeoJSON file says.

    Raises
    ------
    MissionError
        If it is none.
    """
    found = Found(root.source)
    if root['crs']:
        name = root['crs']['properties']['name'].value
        if not str(name).endswith(WORLD_SYSTEMS):
            root['crs'].fail(f'{shown(name)} is not longitude and latitude in WGS84')
    kind = root['type'].value
    features = root['features'].entries() if kind == 'FeatureCollection' else [root]
    for number, feature in enumerate(features, 1):
        of_feature = feature['type'].value == 'Feature'
        geometry = feature['geometry'] if of_feature else feature
        name = _name(feature) if of_feature else ''
        _read_geometry(found, geometry, name or f'feature_{number}', f'feature {number}')
    return found


def _name(feature: JsonValue) -> str:
    properties = feature['properties']
    found = (properties[key].value for key in NAME_KEYS if properties)
    name = next((value for value in found if isinstance(value, str) and value.strip()), None)
    return name or shown(feature['id'].value if feature['id'] else '')


def _read_geometry(found: Found, geometry: JsonValue, name: str, what: str) -> None:
    if not geometry:
        found.leave_out(what, 'it has no geometry')
        return
    for part in _parts(geometry):
        kind, coordinates = part['type'].value, part['coordinates']
        if kind == 'Point':
            point = coordinates.read(lambda given: point_of(given, longitude_first=True))
            found.add_point(name, point, what)
        elif kind == 'Polygon':
            rings = coordinates.entries()
            if not rings:
                coordinates.fail('has no ring')
            polygon = rings[0].read(lambda given: ring_of(given, longitude_first=True))
            found.add_outline(name, polygon, what)
            if len(rings) > 1:
                found.leave_out(what, 'its holes: the area is taken whole')
        elif kind == 'LineString':
            found.add_line(name, coordinates.value, what)
        else:
            part['type'].fail(f'{shown(kind)} is no geometry of GeoJSON')


def _parts(geometry: JsonValue, depth: int = 0) -> Iterator[JsonValue]:
    """Yield the single geometries of one that may have several."""
    kind = geometry['type'].value
    if depth > MAX_DEPTH:
        geometry.fail(f'more than {MAX_DEPTH} collections within each other')
    if kind == 'GeometryCollection':
        for member in geometry['geometries'].entries():
            yield from _parts(member, depth + 1)
    elif kind in ('MultiPoint', 'MultiPolygon', 'MultiLineString'):
        for entry in geometry['coordinates'].entries():
            single = {'type': kind.removeprefix('Multi'), 'coordinates': entry.value}
            yield JsonValue(single, geometry.source, entry.place)
    else:
        yield geometry
