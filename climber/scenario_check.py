"""Whether a scenario that has the right fields and types also makes sense.

What needs only the file is checked when it is read; what needs the robot's limbs and joints is checked by
`check_against_robot` once its model is loaded. Whether the start can be held needs mechanics, and is checked there.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from shapely.geometry import Polygon
from shapely.validation import explain_validity

from climber.exceptions import ModelError
from climber.resources import resolve_model
from climber.solids import newell
from climber.yaml_tree import join, nearest

if TYPE_CHECKING:
    from climber.scenario import Scenario
    from climber.scenario_fields import Place, RobotSpec
    from climber.scenario_shapes import RegionSpec

_SMALLEST_NORMAL = 1e-9
_SMALLEST_AREA = 1e-12  # [m^2]
_SMALLEST_DEPTH = 1e-6  # [m]
_IN_PLANE = 1e-9  # [m, and 1 for unit normals] of holds for planar robots
_FLAT = 1e-6  # [m] corners of a facet are written with so many decimals
_NAME = re.compile(r"[A-Za-z0-9_-]+")
_MODELS = (".urdf", ".sdf", ".xml")


def check_scenario(scenario: Scenario) -> None:
    """Checks everything that the scenario alone can tell.

    Raises:
        ScenarioError: At the first thing that makes no sense.
    """
    _check_holds(scenario)
    for number, region in enumerate(scenario.wall.obstacles):
        _check_region(scenario, region, f"wall.obstacles[{number}]")
    _check_facets(scenario)
    _check_names(scenario)
    started: dict[int, str] = {}
    ended: dict[int, str] = {}
    for number, robot in enumerate(scenario.robots):
        path = f"robots[{number}]"
        _check_model(scenario, number)
        start = {join(f"{path}.start", limb): hold for limb, hold in robot.start.items()}
        _check_distinct(scenario, start, started)
        _check_place(scenario, robot.goal, f"{path}.goal")
        for visited, place in enumerate(robot.waypoints):
            _check_place(scenario, place, f"{path}.waypoints[{visited}]")
        _check_avoid(scenario, number)
        _check_distinct(scenario, dict(_demands(robot.goal, f"{path}.goal")), ended)


def check_against_robot(
    scenario: Scenario,
    robot_index: int,
    limb_names: Sequence[str],
    joint_limits: Mapping[str, tuple[float, float]],
    planar: bool = True,
) -> None:
    """Checks what a scenario says of a robot against the robot.

    Args:
        scenario: The scenario.
        robot_index: Which of its robots.
        limb_names: The limbs of that robot, in limb order.
        joint_limits: Lower and upper limit of each joint by name [rad].
        planar: Whether its pelvis stays in the wall plane.

    Raises:
        ScenarioError: If a limb or joint is unknown, a limb has no hold, a demand on holds has not one for every
            limb, a joint angle is outside its limits, or a planar robot is given a region of space or a
            hold that leaves its plane.
    """
    robot, path = scenario.robots[robot_index], f"robots[{robot_index}]"
    _check_limbs(scenario, robot.start, f"{path}.start", limb_names)
    places = _places(robot, path)
    if planar:
        _check_in_plane(scenario, robot, path)
    for where, place in places:
        if place.stance is not None:
            _check_limbs(scenario, place.stance, f"{where}.stance", limb_names)
        if place.holds is not None and len(place.holds) != len(limb_names):
            raise scenario.error(f"{where}.holds", place.holds, f"{len(limb_names)} holds, one for each limb")
    for joint, angle in robot.start_posture.items():
        where = join(f"{path}.start_posture", joint)
        if joint not in joint_limits:
            raise scenario.error(where, angle, f"no joint of this name; {nearest(joint, list(joint_limits))}")
        lower, upper = joint_limits[joint]
        if not lower <= angle <= upper:
            raise scenario.error(where, angle, f"the joint's range, {lower:g} to {upper:g} rad")


def _places(robot: RobotSpec, path: str) -> list[tuple[str, Place]]:
    """The goal and the waypoints by field path."""
    waypoints = [(f"{path}.waypoints[{number}]", place) for number, place in enumerate(robot.waypoints)]
    return [(f"{path}.goal", robot.goal), *waypoints]


def _check_in_plane(scenario: Scenario, robot: RobotSpec, path: str) -> None:
    """Refuses what reaches out of the plane of a planar robot."""
    regions = [(f"wall.obstacles[{number}]", region) for number, region in enumerate(scenario.wall.obstacles)]
    regions += [(f"{path}.avoid.regions[{number}]", region) for number, region in enumerate(robot.avoid.regions)]
    regions += [(f"{where}.pelvis", place.pelvis) for where, place in _places(robot, path) if place.pelvis is not None]
    for where, region in regions:
        if region.solid is not None:
            shape = next(name for name in ("sphere", "box", "cylinder", "convex") if getattr(region, name) is not None)
            raise scenario.error(where, shape, f"circle or polygon, for {robot.name} moves in the wall plane only")
    for number, spec in enumerate(scenario.wall.holds):
        hold, inside = spec.build(scenario.wall.hold_defaults), f"z = 0, for {robot.name} moves in the plane z = 0 only"
        if abs(hold.position[2]) > _IN_PLANE:
            raise scenario.error(f"wall.holds[{number}].position", spec.position, f"a place with {inside}")
        if hold.grip != "pin" and abs(hold.normal[2]) > _IN_PLANE:  # a pin gives forces all around
            raise scenario.error(f"wall.holds[{number}].normal", spec.normal, f"a normal with {inside}")
    for number, facet in enumerate(scenario.wall.facets):
        if max(corner[2] for corner in facet.corners) > 0.0:
            allowed = f"corners with z no greater than 0, for {robot.name} moves in the plane z = 0 before it"
            raise scenario.error(f"wall.facets[{number}].corners", facet.corners, allowed)


def _check_limbs(scenario: Scenario, stance: Mapping[str, int], path: str, limb_names: Sequence[str]) -> None:
    for limb, hold in stance.items():
        if limb not in limb_names:
            raise scenario.error(join(path, limb), hold, f"no limb of this name; {nearest(limb, limb_names)}")
    for limb in limb_names:
        if limb not in stance:
            raise scenario.error(join(path, limb), None, f"a hold for every limb: {', '.join(limb_names)}")


def _check_holds(scenario: Scenario) -> None:
    defaults = scenario.wall.hold_defaults
    common = "wall.hold_defaults"
    if defaults.grip != "pin" and defaults.min_force > defaults.max_force:
        raise scenario.error(f"{common}.min_force", defaults.min_force, f"at most max_force, {defaults.max_force:g}")
    for number, spec in enumerate(scenario.wall.holds):
        path = f"wall.holds[{number}]"
        _check_direction(scenario, spec.normal, f"{path}.normal")
        hold = spec.build(defaults)
        if hold.grip != "pin" and hold.min_force > hold.max_force:  # a pin has no least force
            if spec.min_force is not None or spec.max_force is None:
                raise scenario.error(f"{path}.min_force", hold.min_force, f"at most max_force, {hold.max_force:g}")
            raise scenario.error(f"{path}.max_force", hold.max_force, f"at least min_force, {hold.min_force:g}")
        if spec.adhesion and hold.grip != "magnet":
            raise scenario.error(f"{path}.adhesion", spec.adhesion, f"0 on a hold of grip {hold.grip}; magnets adhere")
        if spec.max_moment and hold.grip != "pin":
            allowed = f"0 on a hold of grip {hold.grip}; grippers turn pins only"
            raise scenario.error(f"{path}.max_moment", spec.max_moment, allowed)


def _check_region(scenario: Scenario, region: RegionSpec, path: str) -> None:
    given = [shape.name for shape in dataclasses.fields(region) if getattr(region, shape.name) is not None]
    if len(given) != 1:
        allowed = "one of circle: {center, radius}, polygon: {vertices}, sphere, box, cylinder and convex"
        raise scenario.error(path, " and ".join(given) if given else "no shape", allowed)
    if region.polygon is not None:
        _check_polygon(scenario, region.polygon.vertices, f"{path}.polygon.vertices")
    if region.cylinder is not None:
        _check_direction(scenario, region.cylinder.axis, f"{path}.cylinder.axis")
    if region.convex is not None:
        vertices = region.convex.vertices
        spread = np.linalg.svd(np.array(vertices) - np.mean(vertices, axis=0), compute_uv=False)
        if len(vertices) < 4 or spread[2] < _SMALLEST_DEPTH:
            raise scenario.error(f"{path}.convex.vertices", vertices, "at least four points, not all in one plane")


def _check_polygon(scenario: Scenario, vertices: list[list[float]], where: str) -> None:
    if len({tuple(vertex) for vertex in vertices}) < 3:
        raise scenario.error(where, vertices, "at least three different vertices")
    polygon = Polygon(vertices)
    if not polygon.is_valid:
        wrong = explain_validity(polygon)
        raise scenario.error(where, vertices, f"a boundary that does not meet itself ({wrong})")
    if polygon.area < _SMALLEST_AREA:
        raise scenario.error(where, vertices, "a polygon with an area")


def _check_direction(scenario: Scenario, direction: list[float], path: str) -> None:
    if math.hypot(*direction) < _SMALLEST_NORMAL:
        raise scenario.error(path, direction, "a direction, a vector that is not zero")
    if not math.isfinite(math.hypot(*direction)):
        raise scenario.error(path, direction, "a direction whose length a float can hold")


def _check_facets(scenario: Scenario) -> None:
    """Facets are convex and flat, and no hold is inside the rock."""
    for number, spec in enumerate(scenario.wall.facets):
        where, corners = f"wall.facets[{number}].corners", np.array(spec.corners)
        if len(corners) < 3:
            raise scenario.error(where, spec.corners, "at least three corners")
        normal = newell(corners - corners[0])
        off = np.abs((corners - corners[0]) @ normal).max()
        if off > _FLAT:
            raise scenario.error(where, spec.corners, f"corners in one plane; they are up to {off:.3g} m off it")
        along = np.roll(corners, -1, axis=0) - corners
        turns = np.cross(along, np.roll(along, -1, axis=0)) @ normal
        every = np.cross(along[:, None], corners[None] - corners[:, None]) @ normal  # (n, n) left of each side
        if not (turns > _SMALLEST_AREA).all() or every.min() < -_FLAT:
            allowed = "a convex polygon, each corner turning left as seen from outside; divide others into several"
            raise scenario.error(where, spec.corners, allowed)
        rock = spec.build().solid
        for hold, held in enumerate(scenario.wall.holds):
            position = [*held.position, 0.0][:3]
            if float(rock.distance(np.array(position))) == 0.0:
                allowed = f"a place in front of the wall; this is in the rock of wall.facets[{number}]"
                raise scenario.error(f"wall.holds[{hold}].position", held.position, allowed)


def _check_names(scenario: Scenario) -> None:
    names: dict[str, int] = {}
    for number, robot in enumerate(scenario.robots):
        path = f"robots[{number}].name"
        if not _NAME.fullmatch(robot.name):
            raise scenario.error(path, robot.name, "letters, digits, _ and -")
        if robot.name in names:
            raise scenario.error(path, robot.name, f"a name of its own; robots[{names[robot.name]}] has this one")
        names[robot.name] = number


def _check_model(scenario: Scenario, number: int) -> None:
    source, where = scenario.robots[number].model, f"robots[{number}].model"
    try:
        path = resolve_model(source, scenario.folder)
    except ModelError as error:
        raise scenario.error(where, source, str(error)) from error
    if path.suffix not in _MODELS or not path.is_file():
        allowed = f"package://climber/... or a path from the scenario's folder to a {', '.join(_MODELS)} file"
        raise scenario.error(where, source, f"{allowed}; there is none at {path}")


def _check_hold(scenario: Scenario, hold: int, path: str) -> None:
    last = len(scenario.wall.holds) - 1
    if hold > last:
        raise scenario.error(path, hold, f"the number of a hold, 0 to {last}")


def _check_distinct(scenario: Scenario, stood_on: Mapping[str, int], taken: dict[int, str]) -> None:
    """Holds by field path exist and are all different, from one another and from those taken; then they are taken."""
    for path, hold in stood_on.items():
        _check_hold(scenario, hold, path)
        if hold in taken:
            raise scenario.error(path, hold, f"a hold of its own; {taken[hold]} has this one")
        taken[hold] = path


def _demands(place: Place, path: str) -> Iterator[tuple[str, int]]:
    """The holds that a place demands, by field path: those of its stance, or else its holds."""
    if place.stance is not None:
        yield from ((join(f"{path}.stance", limb), hold) for limb, hold in place.stance.items())
    else:
        yield from ((f"{path}.holds[{number}]", hold) for number, hold in enumerate(place.holds or ()))


def _check_place(scenario: Scenario, place: Place, path: str) -> None:
    if place.holds is None and place.stance is None and place.pelvis is None:
        raise scenario.error(path, None, "at least one of holds, stance and pelvis")
    if place.pelvis is not None:
        _check_region(scenario, place.pelvis, f"{path}.pelvis")
    holds = {f"{path}.holds[{number}]": hold for number, hold in enumerate(place.holds or ())}
    _check_distinct(scenario, holds, {})
    _check_distinct(scenario, dict(_demands(place, path)), {})
    if place.holds is not None and place.stance is not None and set(place.holds) != set(place.stance.values()):
        raise scenario.error(f"{path}.stance", place.stance, f"the holds that {path}.holds asks for, {place.holds}")


def _check_avoid(scenario: Scenario, number: int) -> None:
    robot, path = scenario.robots[number], f"robots[{number}]"
    for place, region in enumerate(robot.avoid.regions):
        _check_region(scenario, region, f"{path}.avoid.regions[{place}]")
    demanded = {hold: join(f"{path}.start", limb) for limb, hold in robot.start.items()}
    for where, target in _places(robot, path):
        demanded |= {hold: field for field, hold in _demands(target, where)}
    for place, hold in enumerate(robot.avoid.holds):
        where = f"{path}.avoid.holds[{place}]"
        _check_hold(scenario, hold, where)
        if hold in demanded:
            raise scenario.error(where, hold, f"a hold that the robot need not stand on; {demanded[hold]} asks for it")
