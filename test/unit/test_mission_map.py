"""The maps of `mission_check`: a page that needs no network, and GeoJSON by RFC 7946."""

from __future__ import annotations

import json
import math
import re
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser

import pytest
from shapely.geometry import box, shape
from strategies import case_study

from uav_mission_manager.cli.check.geojson import MOST_CELLS, geojson
from uav_mission_manager.cli.check.html_page import html_page
from uav_mission_manager.cli.check.plausibility import findings
from uav_mission_manager.drawing.places import reaches
from uav_mission_manager.geodesy import ground_distance
from uav_mission_manager.mdp import mission_from_dict

HOSTILE = ('<script>alert(1)</script>', '"onload="x', "'&amp;<!--", ']]></svg></title>')
SVG = '{http://www.w3.org/2000/svg}'


def mission_of(document):
    return mission_from_dict(document, 'test')


def at(longitude, latitude=-35.0, rows=2, cols=4, **grid):
    origin = {'latitude': latitude, 'longitude': longitude, 'altitude': 500.0}
    places = {'rows': rows, 'cols': cols, 'base': 0, 'service': 1, 'origin': origin}
    return mission_of(case_study(grid=places | grid))


def hostile():
    document = case_study(name='</title><script>x</script>')
    document['goals'] = [
        {'name': name, 'cell': cell, 'eta': 1.0, 'delta': 1.0}
        for name, cell in zip(HOSTILE, (2, 3, 5, 6), strict=True)
    ]
    return mission_of(document)


def page_of(mission):
    return html_page(mission, findings(mission))


def svg_of(mission):
    page = page_of(mission)
    return ElementTree.fromstring(page[page.index('<svg') : page.index('</svg>') + 6])


class Elements(HTMLParser):
    """Collects tags, attributes and text of a page."""

    def __init__(self, page):
        super().__init__()
        self.tags, self.attributes, self.text = [], [], []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs

    def handle_data(self, data):
        self.text.append(data)


@pytest.mark.parametrize('mission', [mission_of(case_study()), hostile()])
def test_a_page_loads_and_runs_nothing(mission):
    page = Elements(page_of(mission))
    assert not {'script', 'link', 'img', 'iframe', 'object', 'use', 'image'} & set(page.tags)
    names = {name for name, _ in page.attributes}
    assert not {'src', 'href', 'xlink:href', 'style'} & names
    assert not [name for name in names if name.startswith('on')]
    assert '@import' not in page_of(mission)
    assert set(re.findall(r'url\(([^)]*)\)', page_of(mission))) <= {'#frame'}


def test_hostile_names_are_text():
    page = Elements(page_of(hostile()))
    for name in HOSTILE:
        assert name in page.text
    assert page.text[page.text.index('Mission </title><script>x</script>')]


def test_the_map_is_in_metres_and_well_formed():
    svg = svg_of(mission_of(case_study()))
    ground = next(p for p in svg.iter(f'{SVG}polygon') if p.get('class') == 'ground')
    points = [tuple(map(float, point.split(','))) for point in ground.get('points').split()]
    # 2 x 4 cells of 50 m about the centre of cell 0; south is down.
    assert points == [(-25.0, 75.0), (175.0, 75.0), (175.0, -25.0), (-25.0, -25.0)]
    goals = [(float(c.get('cx')), float(c.get('cy'))) for c in svg.iter(f'{SVG}circle')]
    assert goals == [(50.0, 50.0), (150.0, 0.0), (100.0, 50.0)]
    ways = [line.get('class') for line in svg.iter(f'{SVG}line')]
    assert ways == ['there', 'onward'] * 3
    kinds = {element.get('class') for element in svg.iter()}
    assert {'zone', 'calm', 'base', 'service', 'scale', 'north'} <= kinds


def test_the_scale_bar_is_as_long_as_it_says():
    for size, says in (
        (50.0, '50 m'),
        (3.0, '2 m'),
        (0.3, '0.2 m'),
        (700.0, '500 m'),
        (90_000.0, '50 km'),
    ):
        svg = svg_of(at(149.0, cell_size=size))
        bar = next(p for p in svg.iter(f'{SVG}path') if p.get('class') == 'scale')
        length = float(re.search(r'h([\d.e+]+)', bar.get('d'))[1])
        number, unit = says.split()
        assert length == float(number) * {'m': 1, 'km': 1000}[unit]
        assert says in [text.text for text in svg.iter(f'{SVG}text')]


def test_a_goal_on_the_ring_needs_just_that_charge():
    """From base to any point of it and on to the service cell is the range of its charge."""
    mission = at(149.0, rows=20, cols=20, base=3, service=395, cell_size=100.0)
    base, service = mission.grid.position(3), mission.grid.position(395)
    rings = reaches(mission)
    assert [ring.charge for ring in rings] == [1.0, 0.75]
    for ring in rings:
        for point in ring.ring:
            length = math.dist(base, point) + math.dist(point, service)
            assert length == pytest.approx(ring.distance)
        assert ring.distance == pytest.approx(5 * ring.charge * 0.296 * 3600 - 1000)


def test_a_grid_of_a_million_cells_is_a_small_page():
    mission = at(149.0, rows=1000, cols=1000)
    assert len(page_of(mission)) < 50_000
    assert len(json.dumps(geojson(mission))) < 50_000


def features(mission, kind):
    return [f for f in geojson(mission)['features'] if f['properties']['kind'] == kind]


@pytest.mark.parametrize(
    'place',
    [(149.0, -35.0), (-0.0005, 0.0002), (25.0, 78.0), (179.9990, 10.0), (-179.9999, -80.0)],
)
def test_cells_are_valid_polygons_of_their_size(place):
    mission = at(*place)
    cells = features(mission, 'cell')
    assert [cell['properties']['cell'] for cell in cells] == list(range(8))
    narrow = math.cos(math.radians(place[1]))
    for feature in cells:
        area = shape(feature['geometry'])
        assert area.is_valid
        for part in getattr(area, 'geoms', [area]):
            assert part.exterior.is_ccw
            assert box(-180, -90, 180, 90).contains(part)
        # A degree of latitude is 110.6 to 111.7 km, one of longitude by the cosine less.
        assert area.area * 111_300 * narrow * 111_100 == pytest.approx(2500, rel=0.02)


def test_cells_across_the_180th_meridian_are_cut_there():
    kinds = [cell['geometry']['type'] for cell in features(at(179.9990, 10.0), 'cell')]
    # 0.001 degrees are 110 m there: the third column of cells, at 100 m, lies across.
    assert kinds == ['Polygon', 'Polygon', 'MultiPolygon', 'Polygon'] * 2


def test_goals_are_where_they_are_flown_to():
    mission = at(149.0)
    for feature, goal in zip(features(mission, 'goal'), mission.goals, strict=True):
        longitude, latitude = feature['geometry']['coordinates']
        assert mission.grid.origin.to_local(latitude, longitude) == pytest.approx(
            mission.grid.position(goal.cell), abs=1e-3
        )
        assert feature['properties']['name'] == goal.name
    east = features(mission, 'goal')[1]['geometry']['coordinates']
    assert ground_distance(-35.0, 149.0, east[1], east[0]) == pytest.approx(150, rel=1e-3)


def test_of_a_large_grid_only_what_differs_is_written():
    mission = at(149.0, rows=101, cols=101)
    assert mission.grid.q > MOST_CELLS
    cells = {cell['properties']['cell'] for cell in features(mission, 'cell')}
    assert cells == {0, 1, 2, 3, 5, 6}
    assert len(features(mission, 'grid')) == 1


def test_what_is_in_a_cell_is_told():
    by_cell = {f['properties']['cell']: f['properties'] for f in features(at(149.0), 'cell')}
    assert by_cell[0]['base']
    assert by_cell[1]['service']
    assert by_cell[6]['goals'] == ['goal3']
    assert by_cell[6]['threat_onset'] == 0.25
    assert by_cell[7]['threat_onset'] == 0.05
