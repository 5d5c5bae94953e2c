"""The fields of a scenario file that describe shapes: regions, obstacles, and pieces of the wall's surface.

Conventions are those of `climber.scenario_fields`.
"""

# Drake reads the types of the fields at run time, so this module cannot postpone its annotations.

import dataclasses
import math
from dataclasses import field

import numpy as np
from shapely.geometry import Point, Polygon

from climber.solids import Box, Convex, Cylinder, Facet, Region, Solid, Sphere, away, triple
from climber.wall import circle
from climber.yaml_tree import rule


@dataclasses.dataclass
class CircleSpec:
    """A disk in the wall plane.

    Attributes:
        center: (x, y) in W [m].
        radius: [m], greater than zero.
    """

    center: list[float] = field(default_factory=list, metadata=rule(required=True, lengths=(2,)))
    radius: float = field(default=0.0, metadata=rule(required=True, above=0.0))


@dataclasses.dataclass
class PolygonSpec:
    """A simple polygon in the wall plane.

    Attributes:
        vertices: At least three (x, y) in W [m], in order around the boundary, either way.
    """

    vertices: list[list[float]] = field(default_factory=list, metadata=rule(required=True, lengths=(2,), empty=False))


@dataclasses.dataclass
class SphereSpec:
    """A ball.

    Attributes:
        center: (x, y, z) in W [m].
        radius: [m], greater than zero.
    """

    center: list[float] = field(default_factory=list, metadata=rule(required=True, lengths=(3,)))
    radius: float = field(default=0.0, metadata=rule(required=True, above=0.0))


@dataclasses.dataclass
class BoxSpec:
    """A box.

    Attributes:
        center: (x, y, z) in W [m].
        size: Its lengths along its own axes [m], greater than zero.
        rpy_deg: Roll, pitch and yaw that turn W's axes into its own [degrees].
    """

    center: list[float] = field(default_factory=list, metadata=rule(required=True, lengths=(3,)))
    size: list[float] = field(default_factory=list, metadata=rule(required=True, lengths=(3,), above=0.0))
    rpy_deg: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0], metadata=rule(lengths=(3,)))


@dataclasses.dataclass
class CylinderSpec:
    """A cylinder.

    Attributes:
        center: (x, y, z) in W [m].
        axis: Direction of its axis in W, of any length but zero.
        radius: [m], greater than zero.
        length: Along the axis [m], greater than zero.
    """

    center: list[float] = field(default_factory=list, metadata=rule(required=True, lengths=(3,)))
    axis: list[float] = field(default_factory=list, metadata=rule(required=True, lengths=(3,)))
    radius: float = field(default=0.0, metadata=rule(required=True, above=0.0))
    length: float = field(default=0.0, metadata=rule(required=True, above=0.0))


@dataclasses.dataclass
class ConvexSpec:
    """The convex hull of some points.

    Attributes:
        vertices: At least four (x, y, z) in W [m], not all in one plane.
    """

    vertices: list[list[float]] = field(default_factory=list, metadata=rule(required=True, lengths=(3,), empty=False))


@dataclasses.dataclass
class RegionSpec:
    """A region; exactly one of the shapes is given.

    A circle and a polygon are regions of the wall plane. To a robot in space they reach through all z: its projection
    onto the plane is what comes to lie in them or keeps out of them. The others are regions of space, for robots in
    space only.

    Attributes:
        circle: A disk in the wall plane.
        polygon: A simple polygon in the wall plane.
        sphere: A ball.
        box: A box.
        cylinder: A cylinder.
        convex: The convex hull of some points.
    """

    circle: CircleSpec | None = None
    polygon: PolygonSpec | None = None
    sphere: SphereSpec | None = None
    box: BoxSpec | None = None
    cylinder: CylinderSpec | None = None
    convex: ConvexSpec | None = None

    @property
    def solid(self) -> Solid | None:
        """The region of space; None for a region of the wall plane."""
        if self.sphere is not None:
            return Sphere(triple(self.sphere.center), self.sphere.radius)
        if self.box is not None:
            rpy = triple([math.radians(angle) for angle in self.box.rpy_deg])
            return Box(triple(self.box.center), triple(self.box.size), rpy)
        if self.cylinder is not None:
            length = math.hypot(*self.cylinder.axis)
            axis = triple([component / length for component in self.cylinder.axis])
            return Cylinder(triple(self.cylinder.center), axis, self.cylinder.radius, self.cylinder.length)
        if self.convex is not None:
            return Convex(tuple(triple(vertex) for vertex in self.convex.vertices))
        return None

    def outline(self) -> Polygon:
        """A polygon of the wall plane that contains the region, or its projection: what must be kept clear of."""
        if self.circle is not None:
            return circle(self.circle.center, self.circle.radius)
        solid = self.solid
        return self._polygon() if solid is None else solid.outline()

    def inside(self) -> Region:
        """A polygon that the region contains, or the region of space: where a point must come to lie."""
        if self.circle is not None:
            return Point(*self.circle.center).buffer(self.circle.radius, quad_segs=32)
        return self.solid or self._polygon()

    def distance(self, x: float, y: float, z: float = 0.0) -> float:
        """Distance of a point in W from the region itself [m]; zero inside. z is no matter to regions of the plane."""
        if self.circle is not None:
            return max(0.0, math.dist((x, y), self.circle.center) - self.circle.radius)
        return float(away(self.inside(), np.array([x, y, z])))

    def _polygon(self) -> Polygon:
        assert self.polygon is not None  # scenario_check makes sure of one shape
        return Polygon(self.polygon.vertices)


@dataclasses.dataclass
class FacetSpec:
    """A flat piece of the wall's surface, a convex polygon.

    Attributes:
        corners: At least three (x, y, z) in W [m] in one plane, counter-clockwise as seen from outside.
        thickness: How far the rock goes back behind it [m].
    """

    corners: list[list[float]] = field(default_factory=list, metadata=rule(required=True, lengths=(3,), empty=False))
    thickness: float = field(default=0.3, metadata=rule(above=0.0))

    def build(self) -> Facet:
        """The facet."""
        return Facet(tuple(triple(corner) for corner in self.corners), self.thickness)
