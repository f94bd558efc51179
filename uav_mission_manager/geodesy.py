"""Places on the earth (WGS84), for the mission's map and for the autopilot's positions alike."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pymap3d import enu2geodetic, geodetic2ecef, geodetic2enu


@dataclass(frozen=True)
class Origin:
    """Geographic position of the centre of cell 0, where a plane touches the earth.

    Points of the plane stand for the places below them at the origin's altitude. Whether that is
    above sea level or above the ellipsoid, up to 110 m apart, changes 1 km by 2 cm: no matter.

    Attributes
    ----------
    latitude, longitude : float
        WGS84 [deg].
    altitude : float
        Above mean sea level [m].
    """

    latitude: float
    longitude: float
    altitude: float

    def to_geodetic(self, east: float, north: float) -> tuple[float, float]:
        """Latitude and longitude [deg, -180..180] of a point [m] of the plane."""
        place = self.latitude, self.longitude, self.altitude
        *_, altitude = enu2geodetic(east, north, 0.0, *place)
        # The plane has left the ground by then: 8 m at 10 km, and its vertical leans by 1 cm.
        latitude, longitude, _ = enu2geodetic(east, north, self.altitude - altitude, *place)
        return float(latitude), float(longitude)

    def to_local(self, latitude: float, longitude: float) -> tuple[float, float]:
        """East and north [m] of a latitude and longitude [deg]: `to_geodetic`'s inverse.

        Right to a quarter of the earth away, where the plane would fold back.
        """
        place = self.latitude, self.longitude, self.altitude
        east, north, _ = geodetic2enu(latitude, longitude, self.altitude, *place)
        return float(east), float(north)


def ground_distance(
    latitude: float, longitude: float, other_latitude: float, other_longitude: float
) -> float:
    """Distance [m] between two places on the ellipsoid, latitudes and longitudes in [deg].

    It is the straight line, shorter than the way over ground by 1 mm at 10 km and 1 m at 100 km.
    """
    return math.dist(
        geodetic2ecef(latitude, longitude, 0.0),
        geodetic2ecef(other_latitude, other_longitude, 0.0),
    )
