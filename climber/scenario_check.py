"""Whether a scenario that has the right fields and types also makes sense.

What needs only the file is checked when it is read; what needs the robot's limbs and joints is checked by
`check_against_robot` once its model is loaded. Whether the start can be held needs mechanics, and is checked there.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from shapely.geometry import Polygon
from shapely.validation import explain_validity

from climber.exceptions import ModelError
from climber.resources import resolve_model
from climber.yaml_tree import join, nearest

if TYPE_CHECKING:
    from climber.scenario import Scenario
    from climber.scenario_fields import Place, RegionSpec

_SMALLEST_NORMAL = 1e-9
_SMALLEST_AREA = 1e-12  # [m^2]
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
) -> None:
    """Checks what a scenario says of a robot against the robot.

    Args:
        scenario: The scenario.
        robot_index: Which of its robots.
        limb_names: The limbs of that robot, in limb order.
        joint_limits: Lower and upper limit of each joint by name [rad].

    Raises:
        ScenarioError: If a limb or joint is unknown, a limb has no hold, a demand on holds has not one for every
            limb, or a joint angle is outside its limits.
    """
    robot, path = scenario.robots[robot_index], f"robots[{robot_index}]"
    _check_limbs(scenario, robot.start, f"{path}.start", limb_names)
    places = [(f"{path}.goal", robot.goal)]
    places += [(f"{path}.waypoints[{number}]", place) for number, place in enumerate(robot.waypoints)]
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
        if math.hypot(*spec.normal) < _SMALLEST_NORMAL:
            raise scenario.error(f"{path}.normal", spec.normal, "a direction, a vector that is not zero")
        if not math.isfinite(math.hypot(*spec.normal)):
            raise scenario.error(f"{path}.normal", spec.normal, "a direction whose length a float can hold")
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
    shapes = [shape for shape in (region.circle, region.polygon) if shape is not None]
    if len(shapes) != 1:
        given = "both circle and polygon" if shapes else "neither circle nor polygon"
        raise scenario.error(path, given, "one of circle: {center, radius} and polygon: {vertices}")
    if region.polygon is None:
        return
    vertices = region.polygon.vertices
    where = f"{path}.polygon.vertices"
    if len({tuple(vertex) for vertex in vertices}) < 3:
        raise scenario.error(where, vertices, "at least three different vertices")
    polygon = Polygon(vertices)
    if not polygon.is_valid:
        wrong = explain_validity(polygon)
        raise scenario.error(where, vertices, f"a boundary that does not meet itself ({wrong})")
    if polygon.area < _SMALLEST_AREA:
        raise scenario.error(where, vertices, "a polygon with an area")


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
    for where, target in [
        (f"{path}.goal", robot.goal),
        *((f"{path}.waypoints[{visited}]", waypoint) for visited, waypoint in enumerate(robot.waypoints)),
    ]:
        demanded |= {hold: field for field, hold in _demands(target, where)}
    for place, hold in enumerate(robot.avoid.holds):
        where = f"{path}.avoid.holds[{place}]"
        _check_hold(scenario, hold, where)
        if hold in demanded:
            raise scenario.error(where, hold, f"a hold that the robot need not stand on; {demanded[hold]} asks for it")
