"""The grid of cells and its place on the earth."""

from __future__ import annotations

import math
from dataclasses import dataclass

WGS84_SEMI_MAJOR = 6378137.0
"""Semi-major axis of the WGS84 ellipsoid [m]."""

WGS84_ECCENTRICITY_SQUARED = 6.69437999014e-3
"""First eccentricity of the WGS84 ellipsoid, squared."""


@dataclass(frozen=True)
class Origin:
    """Geographic position of the centre of cell 0.

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

    def _metres_per_degree(self) -> tuple[float, float]:
        """North and east lengths of one degree here, from the WGS84 radii of curvature."""
        phi = math.radians(self.latitude)
        w2 = 1.0 - WGS84_ECCENTRICITY_SQUARED * math.sin(phi) ** 2
        meridian = WGS84_SEMI_MAJOR * (1.0 - WGS84_ECCENTRICITY_SQUARED) / w2**1.5
        prime_vertical = WGS84_SEMI_MAJOR / math.sqrt(w2)
        return math.radians(meridian), math.radians(prime_vertical * math.cos(phi))

    def to_geodetic(self, east: float, north: float) -> tuple[float, float]:
        """Latitude and longitude [deg] of a point of the local tangent plane [m]."""
        per_latitude, per_longitude = self._metres_per_degree()
        return self.latitude + north / per_latitude, self.longitude + east / per_longitude

    def to_local(self, latitude: float, longitude: float) -> tuple[float, float]:
        """East and north [m] of a latitude and longitude [deg]: `to_geodetic`'s inverse."""
        per_latitude, per_longitude = self._metres_per_degree()
        east = (longitude - self.longitude) * per_longitude
        return east, (latitude - self.latitude) * per_latitude


@dataclass(frozen=True)
class Grid:
    """A grid of square cells, numbered row by row from 0; columns run east, rows south.

    Attributes
    ----------
    rows, cols : int
        Size of the grid.
    base, service : int
        Home cell, and the cell where the UAV is recharged and repaired.
    cell_size : float
        Width of a cell [m].
    origin : Origin or None
        Centre of cell 0; needed to fly, not to plan.
    """

    rows: int
    cols: int
    base: int
    service: int
    cell_size: float = 50.0
    origin: Origin | None = None

    @property
    def q(self) -> int:
        """Number of cells."""
        return self.rows * self.cols

    def position(self, cell: int) -> tuple[float, float]:
        """East and north [m] of a cell's centre from the centre of cell 0."""
        row, col = divmod(cell, self.cols)
        return col * self.cell_size, -row * self.cell_size

    def contains(self, east: float, north: float) -> bool:
        """Whether a point [m] lies on the grid."""
        half = self.cell_size / 2
        return (
            -half <= east <= (self.cols - 1) * self.cell_size + half
            and -half <= -north <= (self.rows - 1) * self.cell_size + half
        )

    def cell_at(self, east: float, north: float) -> int:
        """Cell nearest to a point [m]: the one it lies in, on the border where it lies outside."""
        col = min(max(round(east / self.cell_size), 0), self.cols - 1)
        row = min(max(round(-north / self.cell_size), 0), self.rows - 1)
        return row * self.cols + col
