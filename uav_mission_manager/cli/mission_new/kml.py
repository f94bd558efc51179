"""Reads KML, as Google Earth writes it: its placemarks that are points, polygons and lines."""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from uav_mission_manager.cli.mission_new.found import Found, point_of, ring_of
from uav_mission_manager.echo import shown
from uav_mission_manager.mdp import MissionError
from uav_mission_manager.mdp.fields import Bad

LEFT_OUT = {
    'LinearRing': 'a line is neither a place nor an area',
    'Track': 'a track is neither a place nor an area',
    'MultiTrack': 'a track is neither a place nor an area',
    'Model': 'a model is neither a place nor an area',
}
"""Geometries that are left out, and why."""

OVERLAYS = ('GroundOverlay', 'ScreenOverlay', 'PhotoOverlay')


def read_kml(content: bytes, source: str) -> Found:
    """Return what a KML file says.

    A file with a document type is refused: there is none in KML, and entities are declared there
    that grow without bound or read other files. Nothing that a file links to is fetched.

    Raises
    ------
    MissionError
        If it is no KML.
    """
    try:
        root = fromstring(content, forbid_dtd=True)
    except DefusedXmlException as error:
        problem = 'has a document type or entities, which KML has not'
        raise MissionError(f'{shown(source)}: {problem}') from error
    except (ParseError, ValueError, LookupError) as error:
        raise MissionError(f'{shown(source)}: not valid XML: {shown(error)}') from error
    if _kind(root) != 'kml':
        raise MissionError(f'{shown(source)}: is no KML: its root is {shown(_kind(root))}')
    found = Found(source)
    for element in root.iter():
        kind = _kind(element)
        if kind == 'Placemark':
            _read_placemark(found, element)
        elif kind == 'NetworkLink':
            found.leave_out(_name(element) or kind, 'what a link leads to is not read')
        elif kind in OVERLAYS:
            found.leave_out(_name(element) or kind, 'a picture is neither a place nor an area')
    return found


def _kind(element: Element) -> str:
    """Return the name of an element without its namespace: there are several of KML."""
    return str(element.tag).rpartition('}')[2]


def _text(element: Element, *path: str) -> str:
    return (element.findtext('/'.join(f'{{*}}{step}' for step in path)) or '').strip()


def _name(element: Element) -> str:
    return _text(element, 'name')


def _read_placemark(found: Found, placemark: Element) -> None:
    name, taken = _name(placemark) or 'unnamed', False
    what = f'placemark {shown(name)}'
    try:
        for geometry in _geometries(placemark):
            kind = _kind(geometry)
            if kind == 'Point':
                _take_point(found, name, _coordinates(_text(geometry, 'coordinates')))
            elif kind == 'Polygon':
                ring = _text(geometry, 'outerBoundaryIs', 'LinearRing', 'coordinates')
                polygon = ring_of(_coordinates(ring), longitude_first=True)
                found.add_outline(name, polygon, what)
                if geometry.find('{*}innerBoundaryIs') is not None:
                    found.leave_out(what, 'its holes: the area is taken whole')
            elif kind == 'LineString':
                found.add_line(name, _coordinates(_text(geometry, 'coordinates')), what)
            elif kind in LEFT_OUT:
                found.leave_out(what, LEFT_OUT[kind])
            else:
                continue
            taken = True
    except Bad as error:
        found.fail(what, str(error))
    if not taken:
        found.leave_out(what, 'it has no geometry')


def _geometries(placemark: Element) -> Iterator[Element]:
    """Yield what is in a placemark, and in its collections, but not what is below these."""
    waiting = [*reversed(placemark)]
    while waiting:
        element = waiting.pop()
        if _kind(element) == 'MultiGeometry':
            waiting += reversed(element)
        else:
            yield element


def _take_point(found: Found, name: str, coordinates: list[list[float]]) -> None:
    if len(coordinates) != 1:
        raise Bad(f'{len(coordinates)} positions where a point has one')
    point = point_of(coordinates[0], longitude_first=True)
    found.add_point(name, point, f'placemark {shown(name)}')


def _coordinates(text: str) -> list[list[float]]:
    """Return what stands in an element `coordinates`: longitude,latitude[,altitude] by spaces."""
    try:
        return [[float(part) for part in entry.split(',')] for entry in text.split()]
    except ValueError:
        raise Bad(f'coordinates: {shown(text)} are no numbers') from None
