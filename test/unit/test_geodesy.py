"""Distances and maps on the ellipsoid, against closed forms, an integral and surveyed lines."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from uav_mission_manager.geodesy import Origin, ground_distance
from uav_mission_manager.mdp import Grid

SEMI_MAJOR, FLATTENING = 6378137.0, 1 / 298.257223563  # WGS84's defining numbers.
ECCENTRICITY_SQUARED = FLATTENING * (2 - FLATTENING)

latitudes = st.floats(-85, 85)
longitudes = st.floats(-180, 180)
metres = st.floats(-1e4, 1e4)


def meridian_arc(south, north):
    """Length of a meridian [m] between two latitudes [deg], from its radius of curvature."""

    def radius(phi):
        sine = math.sin(phi)
        return (
            SEMI_MAJOR
            * (1 - ECCENTRICITY_SQUARED)
            / (1 - ECCENTRICITY_SQUARED * sine * sine) ** 1.5
        )

    return quad(radius, math.radians(south), math.radians(north), epsabs=1e-9, epsrel=1e-13)[0]


def arc_over(chord):
    """Length over ground of a straight line through a sphere of the earth's mean radius [m]."""
    return 2 * 6371008.8 * math.asin(chord / 2 / 6371008.8)


def degrees(degree, minute, second):
    return math.copysign(abs(degree) + minute / 60 + second / 3600, degree)


def test_the_quarter_meridian_of_the_integral_is_the_published_one():
    assert meridian_arc(0, 90) == pytest.approx(10_001_965.7293, abs=1e-3)


@pytest.mark.parametrize('latitude', [-89.99, -60.0, -35.0, 0.0, 21.3, 45.0, 71.2, 85.0])
@pytest.mark.parametrize('step', [1e-5, 1e-3, 0.08])
def test_distance_along_a_meridian(latitude, step):
    distance = ground_distance(latitude, 7.0, latitude + step, 7.0)
    assert distance == pytest.approx(meridian_arc(latitude, latitude + step), abs=1e-3)


@pytest.mark.parametrize('step', [1e-5, 1e-3, 0.08])
def test_distance_along_the_equator(step):
    """It is a circle of the semi-major axis."""
    expected = SEMI_MAJOR * math.radians(step)
    assert ground_distance(0.0, -3.0, 0.0, step - 3.0) == pytest.approx(expected, abs=1e-3)


FLINDERS_PEAK = degrees(-37, 57, 3.72030), degrees(144, 25, 29.52440)
BUNINYONG = degrees(-37, 39, 10.15610), degrees(143, 55, 35.38390)


def test_a_surveyed_line():
    """54,972.271 m at 306 deg 52' 05.37": Geocentric Datum of Australia Technical Manual."""
    distance = ground_distance(*FLINDERS_PEAK, *BUNINYONG)
    assert distance < 54_972.271
    assert arc_over(distance) == pytest.approx(54_972.271, abs=2e-3)
    east, north = Origin(*FLINDERS_PEAK, 0.0).to_local(*BUNINYONG)
    azimuth = math.degrees(math.atan2(east, north)) % 360
    assert azimuth == pytest.approx(degrees(306, 52, 5.37), abs=0.1 / 3600)


def test_the_distance_grows_to_the_other_side_of_the_earth():
    ways = [ground_distance(0.0, 0.0, 0.0, longitude) for longitude in range(0, 181, 5)]
    assert ways == sorted(ways)
    assert ways[0] == 0.0
    assert ways[-1] == pytest.approx(2 * SEMI_MAJOR)


@given(latitudes, longitudes, st.floats(-500, 9000), metres, metres)
def test_local_and_geodetic_are_inverse(latitude, longitude, altitude, east, north):
    origin = Origin(latitude, longitude, altitude)
    place = origin.to_geodetic(east, north)
    assert -180 <= place[1] <= 180
    assert origin.to_local(*place) == pytest.approx((east, north), abs=1e-3)


@given(latitudes, longitudes, metres, metres)
def test_the_map_is_as_long_as_the_ground(latitude, longitude, east, north):
    """A tangent plane is 6 mm shorter than the ground at 10 km, 16 mm at its corners."""
    place = Origin(latitude, longitude, 0.0).to_geodetic(east, north)
    distance = ground_distance(latitude, longitude, *place)
    assert distance == pytest.approx(math.hypot(east, north), abs=16e-3)


def test_north_and_east_are_those_of_the_compass():
    origin = Origin(47.0, 8.0, 0.0)
    latitude, longitude = origin.to_geodetic(0.0, 1000.0)
    assert latitude - 47.0 == pytest.approx(1000 / meridian_arc(46.5, 47.5), rel=1e-3)
    assert longitude == pytest.approx(8.0, abs=1e-12)
    radius = SEMI_MAJOR / math.sqrt(1 - ECCENTRICITY_SQUARED * math.sin(math.radians(47)) ** 2)
    latitude, longitude = origin.to_geodetic(1000.0, 0.0)
    circle = radius * math.cos(math.radians(47))
    assert longitude - 8.0 == pytest.approx(math.degrees(1000 / circle), rel=1e-6)
    assert latitude == pytest.approx(47.0, abs=1e-5)


def test_a_degree_is_longer_up_on_a_mountain():
    low, high = (Origin(0.0, 0.0, altitude).to_local(0.0, 0.01)[0] for altitude in (0.0, 4000.0))
    assert high / low == pytest.approx(1 + 4000 / SEMI_MAJOR, rel=1e-12)


@pytest.mark.parametrize(('there', 'here'), [(179.99999, -179.99999), (-179.99999, 179.99999)])
def test_the_180th_meridian_is_no_border(there, here):
    apart = SEMI_MAJOR * math.radians(2e-5)
    assert ground_distance(0.0, here, 0.0, there) == pytest.approx(apart, abs=1e-6)
    east, north = Origin(0.0, here, 0.0).to_local(0.0, there)
    assert (abs(east), north) == (pytest.approx(apart, abs=1e-6), 0.0)
    assert math.copysign(1.0, east) == math.copysign(1.0, here)


def test_a_grid_across_the_180th_meridian():
    """The last cell of each row lies beyond it; a vehicle is in the cell over which it stands."""
    grid = Grid(2, 4, 0, 1, 50.0, Origin(-16.8, 179.9990, 100.0))
    places = [grid.origin.to_geodetic(*grid.position(cell)) for cell in range(grid.q)]
    assert [longitude < 0 for _, longitude in places] == [False, False, False, True] * 2
    assert [grid.cell_at(*grid.origin.to_local(*place)) for place in places] == [*range(grid.q)]
    gaps = np.diff([grid.origin.to_local(*place)[0] for place in places[:4]])
    assert gaps == pytest.approx(50.0)
