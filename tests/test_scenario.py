"""Scenario files: what they give when they are right, and what they say when they are not."""

from __future__ import annotations

import copy
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Point

from climber.exceptions import NoPlanFound, ScenarioError
from climber.resources import packaged_scenarios
from climber.scenario import (
    Budget,
    CircleSpec,
    CostWeights,
    PolygonSpec,
    RegionSpec,
    check_against_robot,
    load_scenario,
    scenario_from_text,
)
from climber.solids import Box, Convex, Cylinder, Sphere
from climber.yaml_tree import read_tree

MODEL = "package://climber/quadruped/quadruped.urdf"
LIMBS = ("right_front", "left_front", "left_rear", "right_rear")
LIMITS = {"right_front_hip": (-2.1, 2.1), "right_front_knee": (-2.6, 2.6)}

BASE: dict[str, Any] = {
    "name": "small",
    "seed": 3,
    "wall": {
        "hold_defaults": {"min_force": 1.0},
        "holds": [
            {"position": [0.0, 0.0], "normal": [0.0, 2.0], "friction": 0.5},
            {"position": [0.1, 0.0], "normal": [3.0, 4.0]},
            {"position": [0.2, 0.0], "normal": [0.0, 1.0], "grip": "pin", "max_force": 0.5},
            {"position": [0.3, 0.0], "normal": [0.0, 1.0], "grip": "magnet", "adhesion": 7.0, "half_width": 0.0},
            {"position": [0.4, 0.0], "normal": [0.0, 1.0]},
        ],
        "obstacles": [
            {"circle": {"center": [1.0, 1.0], "radius": 0.1}},
            {"polygon": {"vertices": [[2.0, 0.0], [3.0, 0.0], [2.0, 1.0]]}},
        ],
    },
    "robots": [
        {
            "name": "quadruped",
            "model": MODEL,
            "start": dict(zip(LIMBS, (3, 1, 0, 2), strict=True)),
            "start_posture": {"right_front_hip": 0.5},
            "goal": {
                "holds": [0, 1, 2, 4],
                "pelvis": {"circle": {"center": [0.2, 0.1], "radius": 0.05}},
            },
            "waypoints": [{"name": "lookout", "stance": dict(zip(LIMBS, (4, 3, 2, 1), strict=True))}],
            "avoid": {"holds": [], "regions": [{"circle": {"center": [9.0, 9.0], "radius": 1.0}}]},
        }
    ],
}
GONE = object()


def edited(path: tuple[str | int, ...], value: object) -> dict[str, Any]:
    """`BASE` with one value replaced, or taken away."""
    tree = copy.deepcopy(BASE)
    node: Any = tree
    for step in path[:-1]:
        node = node[step]
    if value is GONE:
        del node[path[-1]]
    else:
        node[path[-1]] = value
    return tree


def load(tree: object) -> Any:
    return scenario_from_text(yaml.safe_dump(tree, sort_keys=False), "wall.yaml")


def refusal(tree: object) -> ScenarioError:
    with pytest.raises(ScenarioError) as caught:
        load(tree)
    assert str(caught.value).startswith("wall.yaml: ")
    return caught.value


def text_refusal(text: str) -> ScenarioError:
    with pytest.raises(ScenarioError) as caught:
        scenario_from_text(text, "wall.yaml")
    assert str(caught.value).startswith("wall.yaml: ")
    return caught.value


# What is read


def test_fields_not_given_have_their_defaults() -> None:
    scenario = load(BASE)
    assert scenario.seed == 3
    assert scenario.cost == CostWeights(100.0, 1.0, 1.0)
    assert scenario.budget == Budget()
    assert scenario.budget.time_limit_s == 120.0
    assert scenario.robots[0].avoid.holds == []
    assert scenario.wall.inclination_deg == 90.0


def test_holds_take_the_wall_s_defaults_and_override_them() -> None:
    wall = load(BASE).build_wall()
    assert [h.friction for h in wall.holds] == [0.5, 0.6, 0.6, 0.6, 0.6]
    assert [h.min_force for h in wall.holds] == [1.0] * 5
    assert [h.max_force for h in wall.holds] == [20.0, 20.0, 0.5, 20.0, 20.0]
    assert [h.half_width for h in wall.holds] == [0.01, 0.01, 0.01, 0.0, 0.01]
    assert [h.grip for h in wall.holds] == ["friction", "friction", "pin", "magnet", "friction"]
    assert [h.adhesion for h in wall.holds] == [0.0, 0.0, 0.0, 7.0, 0.0]


def test_default_adhesion_is_of_magnets_only() -> None:
    wall = load(edited(("wall", "hold_defaults"), {"adhesion": 5.0})).build_wall()
    assert [h.adhesion for h in wall.holds] == [0.0, 0.0, 0.0, 7.0, 0.0]


def test_default_moment_is_of_pins_only() -> None:
    wall = load(edited(("wall", "hold_defaults"), {"max_moment": 2.0})).build_wall()
    assert [h.max_moment for h in wall.holds] == [0.0, 0.0, 2.0, 0.0, 0.0]


def test_normals_are_normalised_and_positions_completed() -> None:
    wall = load(edited(("wall", "holds", 1), {"position": [0.1, 0.0, 0.02], "normal": [0.0, 3.0, 4.0]})).build_wall()
    np.testing.assert_allclose(np.linalg.norm(wall.normals, axis=1), 1.0, atol=1e-15)
    np.testing.assert_allclose(wall.normals[1], [0.0, 0.6, 0.8])
    np.testing.assert_allclose(wall.positions[:2], [[0.0, 0.0, 0.0], [0.1, 0.0, 0.02]])


def test_regions_of_space_are_solids_and_those_of_the_plane_are_not() -> None:
    solids = [
        {"sphere": {"center": [0.0, 1.0, 2.0], "radius": 0.5}},
        {"box": {"center": [0.0, 0.0, 1.0], "size": [1.0, 2.0, 3.0], "rpy_deg": [0.0, 0.0, 90.0]}},
        {"cylinder": {"center": [0.0, 0.0, 1.0], "axis": [0.0, 3.0, 4.0], "radius": 0.5, "length": 1.0}},
        {"convex": {"vertices": [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 2.0]]}},
    ]
    tree = edited(("wall", "obstacles"), [*BASE["wall"]["obstacles"], *solids])
    scenario = load(tree)
    wall = scenario.build_wall()
    assert len(wall.obstacles) == 2
    ball, box, cylinder, convex = wall.solids
    assert ball == Sphere((0.0, 1.0, 2.0), 0.5)
    assert isinstance(box, Box)
    np.testing.assert_allclose(box.extremes, [[-1.0, -0.5, -0.5], [1.0, 0.5, 2.5]], atol=1e-12)
    assert isinstance(cylinder, Cylinder)
    assert cylinder.axis == (0.0, 0.6, 0.8)
    assert convex == Convex(((0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (0.0, 1.0, 1.0), (0.0, 0.0, 2.0)))
    for region, solid in zip(scenario.wall.obstacles[2:], wall.solids, strict=True):
        assert region.inside() == solid
        assert region.distance(3.0, 0.0, 1.0) == pytest.approx(float(solid.distance(np.array([3.0, 0.0, 1.0]))))
    assert scenario.wall.obstacles[0].distance(1.0, 3.0, 5.0) == pytest.approx(1.9)  # z is no matter


def test_limbs_keep_the_order_of_the_file() -> None:
    assert list(load(BASE).robots[0].start) == list(LIMBS)


def test_the_text_is_kept_verbatim_and_reads_the_same_again() -> None:
    for path in packaged_scenarios().values():
        scenario = load_scenario(path)
        assert scenario.source == path.read_text(encoding="utf-8")
        again = scenario_from_text(scenario.source, "elsewhere.yaml", scenario.folder)
        assert again == scenario
        assert again.file == "elsewhere.yaml"


def test_a_scenario_without_a_name_is_called_after_its_file() -> None:
    assert scenario_from_text(yaml.safe_dump(edited(("name",), GONE)), "some/cliff.yaml").name == "cliff"


def test_obstacles_are_not_made_smaller_and_goals_not_larger() -> None:
    disk = RegionSpec(circle=CircleSpec([0.3, 0.4], 0.05))
    angles = np.linspace(0, 2 * np.pi, 1000)
    rim = np.array([0.3, 0.4]) + 0.05 * np.column_stack([np.cos(angles), np.sin(angles)])
    assert all(disk.outline().buffer(1e-12).contains(Point(p)) for p in rim)
    assert max(math.dist(p, (0.3, 0.4)) for p in disk.inside().exterior.coords) <= 0.05 + 1e-12
    assert disk.inside().area > 0.99 * math.pi * 0.05**2


def test_distance_from_a_region_is_zero_inside() -> None:
    disk = RegionSpec(circle=CircleSpec([0.0, 0.0], 1.0))
    square = RegionSpec(polygon=PolygonSpec([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]))
    assert disk.distance(0.6, 0.0) == 0.0
    assert disk.distance(3.0, 4.0) == pytest.approx(4.0)
    assert square.distance(0.5, 0.5) == 0.0
    assert square.distance(0.5, -2.0) == pytest.approx(2.0)
    assert square.inside().equals(square.outline())


def test_a_bom_and_comments_and_templates_are_no_matter(tmp_path: Path) -> None:
    text = yaml.safe_dump(BASE).replace("wall:", "# a comment\nwall:", 1)
    path = tmp_path / "wall.yaml"
    path.write_text("\ufeff_up: &up [0.0, 1.0]\n" + text, encoding="utf-8")
    assert load_scenario(path) == load(BASE)


def test_merge_keys_and_anchors_are_resolved() -> None:
    text = yaml.safe_dump(BASE)
    text = "_soft: &soft {max_force: 5.0, normal: [0.0, 1.0]}\n" + text
    tree = read_tree(text, "wall.yaml")
    tree["wall"]["holds"][4] = {"position": [0.4, 0.0], "max_force": 5.0, "normal": [0.0, 1.0]}
    flow = yaml.safe_dump(tree).replace(
        "  - max_force: 5.0\n    normal:\n    - 0.0\n    - 1.0\n", "  - <<: *soft\n    max_force: 6.0\n"
    )
    scenario = scenario_from_text("_soft: &soft {max_force: 5.0, normal: [0.0, 1.0]}\n" + flow, "wall.yaml")
    assert scenario.build_wall().holds[4].max_force == 6.0
    assert scenario.build_wall().holds[4].normal == (0.0, 1.0, 0.0)


@pytest.mark.parametrize("written", ["0.001", "1e-3", "1E-3", "1.0e-3", "1.e-3", ".1e-2", "+1e-3"])
def test_numbers_are_those_of_yaml_1_2(written: str) -> None:
    text = yaml.safe_dump(edited(("wall", "hold_defaults", "half_width"), 77)).replace("77", written)
    assert scenario_from_text(text, "wall.yaml").wall.hold_defaults.half_width == pytest.approx(0.001)


def test_packaged_scenarios_go_by_their_bare_names() -> None:
    basic, higher = load_scenario("basic"), load_scenario("higher")
    assert len(basic.wall.holds) == 10
    assert list(basic.robots[0].start.items()) == [
        ("right_front", 3),
        ("left_front", 1),
        ("left_rear", 0),
        ("right_rear", 2),
    ]
    assert basic.robots[0].goal.holds == [6, 7, 8, 9]
    assert len(higher.wall.holds) == 21
    assert list(higher.robots[0].start.values()) == [5, 3, 2, 1]
    assert higher.robots[0].goal.holds == [17, 18, 19, 20]
    for scenario in (basic, higher):
        holds = scenario.build_wall().positions[scenario.robots[0].goal.holds]
        pelvis = scenario.robots[0].goal.pelvis
        assert pelvis is not None and pelvis.circle is not None
        np.testing.assert_allclose(pelvis.circle.center, holds[:, :2].mean(axis=0), atol=1e-6)
        assert pelvis.circle.radius == 0.06
        hold = scenario.build_wall().holds[0]
        assert (hold.half_width, hold.min_force, hold.max_force) == (0.01, 0.5, 20.0)


# What is refused: where in the tree, what is put there, the field named, and words of what is allowed

ROBOT: tuple[str | int, ...] = ("robots", 0)
HOLD: tuple[str | int, ...] = ("wall", "holds", 3)
NAN, INF = float("nan"), float("inf")
BOW = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]
SOLID: tuple[str | int, ...] = ("wall", "obstacles", 0)
FIRST = "wall.obstacles[0]"
FACETS: tuple[str | int, ...] = ("wall", "facets")
CORNERS = "wall.facets[0].corners"
SLAB = [[-9.0, -9.0, -1.0], [9.0, -9.0, -1.0], [9.0, 9.0, -1.0], [-9.0, 9.0, -1.0]]  # behind everything
POLYGON: tuple[str | int, ...] = ("wall", "obstacles", 1, "polygon", "vertices")

REFUSED: dict[str, tuple[tuple[str | int, ...], object, str, str]] = {
    # unknown and missing fields
    "unknown field at the root": (("sead",), 1, "sead", "did you mean seed?"),
    "unknown field of a hold": ((*HOLD, "frictoin"), 0.5, "wall.holds[3].frictoin", "did you mean friction?"),
    "unknown field far from any": ((*HOLD, "zzzz"), 0.5, "wall.holds[3].zzzz", "position, normal, half_width"),
    "unknown field of the budget": (("budget",), {"time_limit": 3}, "budget.time_limit", "time_limit_s"),
    "unknown field of a region": ((*ROBOT, "goal", "pelvis"), {"disk": 1}, "robots[0].goal.pelvis.disk", "circle"),
    "field that holds only the result": (("source",), "x", "source", "no field of this name"),
    "no wall": (("wall",), GONE, "wall", "must be given"),
    "no robots": (("robots",), GONE, "robots", "must be given"),
    "no holds": (("wall", "holds"), GONE, "wall.holds", "must be given"),
    "no position": ((*HOLD, "position"), GONE, "wall.holds[3].position", "must be given"),
    "no normal": ((*HOLD, "normal"), GONE, "wall.holds[3].normal", "must be given"),
    "no model": ((*ROBOT, "model"), GONE, "robots[0].model", "must be given"),
    "no start": ((*ROBOT, "start"), GONE, "robots[0].start", "must be given"),
    "no goal": ((*ROBOT, "goal"), GONE, "robots[0].goal", "must be given"),
    # types
    "null for a mapping": (("wall",), None, "wall", "inclination_deg"),
    "list for a mapping": (("wall",), [], "wall", "inclination_deg"),
    "null for a list": (("wall", "holds"), None, "wall.holds", "a list"),
    "mapping for a list": (("wall", "holds"), {"a": 1}, "wall.holds", "a list"),
    "text for a list": (("wall", "holds"), "abc", "wall.holds", "a list"),
    "quoted number": ((*HOLD, "friction"), "0.5", "wall.holds[3].friction", "a finite number >= 0"),
    "word for a number": ((*HOLD, "friction"), "much", "wall.holds[3].friction", "a finite number >= 0"),
    "truth value for a number": ((*HOLD, "friction"), True, "wall.holds[3].friction", "a finite number >= 0"),
    "truth value in a list": ((*HOLD, "position"), [True, 0.0], "wall.holds[3].position[0]", "a finite number"),
    "truth value for a seed": (("seed",), True, "seed", "a whole number >= 0"),
    "list for a number": (("seed",), [1], "seed", "a whole number >= 0"),
    "fraction for a seed": (("seed",), 1.5, "seed", "a whole number >= 0"),
    "float for a hold number": ((*ROBOT, "start", "left_rear"), 0.0, "robots[0].start.left_rear", "a whole number"),
    "null for a number": (("seed",), None, "seed", "a whole number"),
    "number for a name": (("name",), 3, "name", "text"),
    "date for a name": (("description",), ["x"], "description", "text"),
    "number for a limb": ((*ROBOT, "start"), {1: 2}, "robots[0].start.1", "a name, not 1, before the colon"),
    "list for a start": ((*ROBOT, "start"), [3, 1, 0, 2], "robots[0].start", "a mapping of names"),
    "numbers for vertices": (POLYGON, [1.0, 2.0, 3.0], "wall.obstacles[1].polygon.vertices[0]", "a list of 2 numbers"),
    "one number for a position": ((*HOLD, "position"), [1.0], "wall.holds[3].position", "a list of 2 or 3 numbers"),
    "four for a normal": ((*HOLD, "normal"), [1.0, 0.0, 0.0, 0.0], "wall.holds[3].normal", "2 or 3 numbers"),
    "three for a centre": (
        ("wall", "obstacles", 0, "circle", "center"),
        [1.0, 0.0, 0.0],
        "wall.obstacles[0].circle.center",
        "2 numbers",
    ),
    # numbers
    "not a number": ((*HOLD, "friction"), NAN, "wall.holds[3].friction", "a finite number"),
    "infinite friction": ((*HOLD, "friction"), INF, "wall.holds[3].friction", "a finite number"),
    "infinite position": ((*HOLD, "position"), [0.0, -INF], "wall.holds[3].position[1]", "a finite number"),
    "huge integer": ((*HOLD, "friction"), 10**400, "wall.holds[3].friction", "a finite number"),
    "not a number in a vertex": (
        POLYGON,
        [[0.0, NAN], [1.0, 0.0], [0.0, 1.0]],
        "wall.obstacles[1].polygon.vertices[0][1]",
        "a finite number",
    ),
    "not a number for a joint": (
        (*ROBOT, "start_posture", "right_front_hip"),
        NAN,
        "robots[0].start_posture.right_front_hip",
        "a finite number",
    ),
    "negative friction": ((*HOLD, "friction"), -0.1, "wall.holds[3].friction", ">= 0"),
    "negative default friction": (("wall", "hold_defaults", "friction"), -0.1, "wall.hold_defaults.friction", ">= 0"),
    "negative half width": ((*HOLD, "half_width"), -0.1, "wall.holds[3].half_width", ">= 0"),
    "negative least force": ((*HOLD, "min_force"), -1, "wall.holds[3].min_force", ">= 0"),
    "zero greatest force": ((*HOLD, "max_force"), 0, "wall.holds[3].max_force", "> 0"),
    "moment without a pin": ((*HOLD, "max_moment"), 1.0, "wall.holds[3].max_moment", "pins"),
    "negative adhesion": ((*HOLD, "adhesion"), -1, "wall.holds[3].adhesion", ">= 0"),
    "negative seed": (("seed",), -1, "seed", ">= 0"),
    "tilted back": (("wall", "inclination_deg"), -1.0, "wall.inclination_deg", ">= 0 and < 180"),
    "upside down": (("wall", "inclination_deg"), 180.0, "wall.inclination_deg", ">= 0 and < 180"),
    "negative cost": (("cost",), {"reach": -1}, "cost.reach", ">= 0"),
    "no time": (("budget",), {"time_limit_s": 0}, "budget.time_limit_s", "> 0"),
    "no samples": (("budget",), {"posture_samples": 0}, "budget.posture_samples", ">= 1"),
    "too few samples a second": (("budget",), {"sample_rate_hz": 50}, "budget.sample_rate_hz", ">= 100"),
    "zero radius": (("wall", "obstacles", 0, "circle", "radius"), 0, "wall.obstacles[0].circle.radius", "> 0"),
    # holds
    "zero normal": ((*HOLD, "normal"), [0.0, 0.0], "wall.holds[3].normal", "not zero"),
    "next to zero normal": ((*HOLD, "normal"), [1e-300, 0.0, 0.0], "wall.holds[3].normal", "not zero"),
    "overlong normal": ((*HOLD, "normal"), [1.7e308, 1.7e308], "wall.holds[3].normal", "a direction"),
    "bad grip": ((*HOLD, "grip"), "glue", "wall.holds[3].grip", "one of friction, pin, magnet"),
    "number for a grip": ((*HOLD, "grip"), 3, "wall.holds[3].grip", "one of friction, pin, magnet"),
    "bad default grip": (("wall", "hold_defaults", "grip"), "x", "wall.hold_defaults.grip", "one of friction"),
    "forces crossed": ((*HOLD, "min_force"), 21.0, "wall.holds[3].min_force", "at most max_force, 20"),
    "forces crossed by the greatest": ((*HOLD, "max_force"), 0.5, "wall.holds[3].max_force", "at least min_force, 1"),
    "forces crossed by default": (
        ("wall", "hold_defaults", "min_force"),
        21.0,
        "wall.hold_defaults.min_force",
        "at most max_force, 20",
    ),
    "adhesion without a magnet": ((*HOLD, "grip"), "friction", "wall.holds[3].adhesion", "magnets"),
    # regions
    "two shapes": (
        ("wall", "obstacles", 1, "circle"),
        {"center": [0.0, 0.0], "radius": 1.0},
        "wall.obstacles[1]",
        "one of circle",
    ),
    "no shape": (("wall", "obstacles", 1), {}, "wall.obstacles[1]", "one of circle"),
    "no shape for the pelvis": ((*ROBOT, "goal", "pelvis"), {}, "robots[0].goal.pelvis", "one of circle"),
    "no shape to avoid": ((*ROBOT, "avoid", "regions"), [{}], "robots[0].avoid.regions[0]", "one of circle"),
    "crossing polygon": (POLYGON, BOW, "wall.obstacles[1].polygon.vertices", "does not meet itself"),
    "two vertices": (POLYGON, BOW[:2], "wall.obstacles[1].polygon.vertices", "three different"),
    "one vertex three times": (POLYGON, BOW[:1] * 3, "wall.obstacles[1].polygon.vertices", "three different"),
    "vertices on a line": (
        POLYGON,
        [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]],
        "wall.obstacles[1].polygon.vertices",
        "does not meet itself",
    ),
    "sliver": (POLYGON, [[0.0, 0.0], [1.0, 0.0], [0.5, 1e-13]], "wall.obstacles[1].polygon.vertices", "an area"),
    "a solid and a circle": (
        ("wall", "obstacles", 0, "sphere"),
        {"center": [0.0, 0.0, 0.0], "radius": 1.0},
        "wall.obstacles[0]",
        "one of circle",
    ),
    "a flat center": (SOLID, {"sphere": {"center": [0.0, 0.0], "radius": 1.0}}, f"{FIRST}.sphere.center", "3 numbers"),
    "a flat box": (SOLID, {"box": {"center": [0.0] * 3, "size": [1.0, 0.0, 1.0]}}, f"{FIRST}.box.size[1]", "> 0"),
    "no axis": (
        SOLID,
        {"cylinder": {"center": [0.0] * 3, "axis": [0.0] * 3, "radius": 1.0, "length": 1.0}},
        f"{FIRST}.cylinder.axis",
        "not zero",
    ),
    "points in a plane": (
        SOLID,
        {"convex": {"vertices": [[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 1.0, 1.0]]}},
        f"{FIRST}.convex.vertices",
        "not all in one plane",
    ),
    # facets
    "two corners": (FACETS, [{"corners": SLAB[:2]}], CORNERS, "at least three"),
    "corners off a plane": (FACETS, [{"corners": [*SLAB[:3], [-9.0, 9.0, -0.9]]}], CORNERS, "0.0"),
    "corners on a line": (
        FACETS,
        [{"corners": [[0.0, 0.0, -1.0], [1.0, 0.0, -1.0], [2.0, 0.0, -1.0]]}],
        CORNERS,
        "left",
    ),
    "a facet with a dent": (FACETS, [{"corners": [*SLAB[:3], [0.0, 0.0, -1.0]]}], CORNERS, "convex"),
    "a facet with crossing sides": (FACETS, [{"corners": [SLAB[0], SLAB[1], SLAB[3], SLAB[2]]}], CORNERS, "convex"),
    "no rock": (FACETS, [{"corners": SLAB, "thickness": 0.0}], "wall.facets[0].thickness", "> 0"),
    "a hold in the rock": (
        FACETS,
        [{"corners": [[x, y, 0.01] for x, y, _ in SLAB]}],
        "wall.holds[0].position",
        "wall.facets[0]",
    ),
    # empty
    "no holds in the list": (("wall", "holds"), [], "wall.holds", "not empty"),
    "no robots in the list": (("robots",), [], "robots", "not empty"),
    "empty start": ((*ROBOT, "start"), {}, "robots[0].start", "not an empty one"),
    "empty goal": ((*ROBOT, "goal"), {}, "robots[0].goal", "at least one of holds, stance and pelvis"),
    "empty goal holds": ((*ROBOT, "goal", "holds"), [], "robots[0].goal.holds", "not empty"),
    "empty waypoint": ((*ROBOT, "waypoints"), [{"name": "x"}], "robots[0].waypoints[0]", "at least one of"),
    "no vertices": (POLYGON, [], "wall.obstacles[1].polygon.vertices", "not empty"),
    "empty model": ((*ROBOT, "model"), "", "robots[0].model", "not empty"),
    "blank robot name": ((*ROBOT, "name"), " ", "robots[0].name", "not empty"),
    # robots
    "two limbs on one hold": ((*ROBOT, "start", "left_rear"), 3, "robots[0].start.left_rear", "right_front has this"),
    "hold that is not there": ((*ROBOT, "start", "left_rear"), 5, "robots[0].start.left_rear", "0 to 4"),
    "negative hold number": ((*ROBOT, "start", "left_rear"), -1, "robots[0].start.left_rear", ">= 0"),
    "goal hold that is not there": ((*ROBOT, "goal", "holds"), [0, 9], "robots[0].goal.holds[1]", "0 to 4"),
    "goal hold twice": ((*ROBOT, "goal", "holds"), [0, 1, 1, 2], "robots[0].goal.holds[2]", "holds[1] has this"),
    "goal stance against goal holds": (
        (*ROBOT, "goal", "stance"),
        dict(zip(LIMBS, (0, 1, 2, 3), strict=True)),
        "robots[0].goal.stance",
        "[0, 1, 2, 4]",
    ),
    "waypoint hold that is not there": (
        (*ROBOT, "waypoints", 0, "stance", "left_rear"),
        7,
        "robots[0].waypoints[0].stance.left_rear",
        "0 to 4",
    ),
    "two limbs on one hold at a waypoint": (
        (*ROBOT, "waypoints", 0, "stance", "left_rear"),
        4,
        "robots[0].waypoints[0].stance.left_rear",
        "a hold of its own",
    ),
    "avoided hold that is not there": ((*ROBOT, "avoid", "holds"), [5], "robots[0].avoid.holds[0]", "0 to 4"),
    "start on an avoided hold": (
        (*ROBOT, "avoid", "holds"),
        [3],
        "robots[0].avoid.holds[0]",
        "robots[0].waypoints[0].stance.left_front asks for it",
    ),
    "unknown package": ((*ROBOT, "model"), "package://nobody/x.urdf", "robots[0].model", "package://climber/"),
    "no such model": ((*ROBOT, "model"), "package://climber/no/no.urdf", "robots[0].model", "there is none at"),
    "no such model file": ((*ROBOT, "model"), "no.sdf", "robots[0].model", "there is none at"),
    "folder for a model": ((*ROBOT, "model"), "package://climber/quadruped", "robots[0].model", "there is none at"),
    "robot name of other letters": ((*ROBOT, "name"), "a b", "robots[0].name", "letters, digits"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_with_field_value_and_what_is_allowed(case: str) -> None:
    path, value, field, allowed = REFUSED[case]
    error = refusal(edited(path, value))
    assert error.path == field
    assert f": {field}: " in str(error)
    assert allowed in str(error)
    assert error.file == "wall.yaml"
    if value is GONE:
        assert "nothing given" in str(error)
    else:
        assert "given" in str(error)


def test_the_value_given_is_in_the_message() -> None:
    assert "given -0.1; allowed" in str(refusal(edited((*HOLD, "friction"), -0.1)))
    assert "given '0.5'; allowed" in str(refusal(edited((*HOLD, "friction"), "0.5")))
    assert "given null; allowed" in str(refusal(edited(("seed",), None)))
    assert "given True; allowed" in str(refusal(edited(("seed",), True)))


def test_a_pin_has_no_least_force_to_cross() -> None:
    assert load(BASE).build_wall().holds[2].max_force == 0.5


def two_robots(**second: object) -> dict[str, Any]:
    tree = copy.deepcopy(BASE)
    tree["wall"]["holds"] += [{"position": [x, 1.0], "normal": [0, 1]} for x in range(8)]
    other = {
        "name": "other",
        "model": MODEL,
        "start": dict(zip(LIMBS, (5, 6, 7, 8), strict=True)),
        "goal": {"holds": [9, 10, 11, 12]},
    }
    tree["robots"].append(other | second)
    return tree


def test_two_robots_may_share_nothing() -> None:
    assert [robot.name for robot in load(two_robots()).robots] == ["quadruped", "other"]
    same_name = refusal(two_robots(name="quadruped"))
    assert same_name.path == "robots[1].name" and "robots[0]" in str(same_name)
    same_start = refusal(two_robots(start=dict(zip(LIMBS, (5, 6, 7, 0), strict=True))))
    assert same_start.path == "robots[1].start.right_rear"
    assert "robots[0].start.left_rear has this one" in str(same_start)
    same_goal = refusal(two_robots(goal={"holds": [9, 10, 11, 4]}))
    assert same_goal.path == "robots[1].goal.holds[3]"
    assert "robots[0].goal.holds[3] has this one" in str(same_goal)


# Text that is not a scenario


@pytest.mark.parametrize("text", ["", "\n", "# nothing\n", "---\n"])
def test_an_empty_file_is_refused(text: str) -> None:
    assert "an empty file" in str(text_refusal(text))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("wall: [1, 2", "line 1, column 12"),
        ("a: b: c", "line 1, column 5"),
        ("\tname: x", "line 1"),
        ("name: !!python/object:os.system {}", "python/object"),
        ("name: !Custom {}", "Custom"),
        ("? [a]\n: 1", "unhashable"),
        ("name: x\n---\nname: y", "a single document"),
        ("name: *nobody", "undefined alias"),
        ("a: \x00", "not YAML"),
        ("seed: !!int x", "not YAML"),
        ("[" * 5000, "not YAML"),
        ("just words", "a YAML mapping of fields"),
        ("[1, 2]", "a YAML mapping of fields"),
    ],
)
def test_text_that_is_not_a_yaml_mapping_is_refused(text: str, words: str) -> None:
    assert words in str(text_refusal(text))


def test_a_key_given_twice_is_refused_wherever_it_is() -> None:
    text = yaml.safe_dump(BASE, sort_keys=False)
    error = text_refusal(text.replace("seed: 3", "seed: 3\nseed: 4"))
    assert error.path == "seed"
    assert "lines 2 and 3" in str(error) and "'4'" in str(error)
    error = text_refusal(text.replace("    friction: 0.5\n", "    friction: 0.5\n    friction: 0.5\n"))
    assert error.path == "wall.holds[0].friction"
    error = text_refusal("seed: {a: 1, a: 2}")
    assert error.path == "seed.a" and "(line 1)" in str(error)


def test_a_tree_that_contains_itself_is_refused() -> None:
    assert text_refusal("robots: &loop [*loop]").path == "wall"
    text = yaml.safe_dump(edited(("wall",), GONE))
    assert text_refusal(text + "wall: &loop {holds: [*loop]}").path == "wall.holds[0].holds"


def test_aliases_that_multiply_are_refused_at_once() -> None:
    levels = "\n".join(f"  - &l{n + 1} [{', '.join([f'*l{n}'] * 10)}]" for n in range(30))
    assert text_refusal(f"seed:\n  - &l0 [x]\n{levels}").path == "seed"


@pytest.mark.parametrize("written", ["010", "1:30", "1_0", "0x10", "yes", "2001-01-01"])
def test_scalars_that_only_yaml_1_1_takes_for_numbers_are_refused(written: str) -> None:
    text = yaml.safe_dump(edited(("seed",), 77)).replace("77", written)
    assert text_refusal(text).path == "seed"


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"nowhere\.yaml: No such file.*basic, .*higher") as caught:
        load_scenario(tmp_path / "nowhere.yaml")
    assert caught.value.file == str(tmp_path / "nowhere.yaml")
    with pytest.raises(ScenarioError, match="directory"):
        load_scenario(tmp_path)
    (tmp_path / "latin.yaml").write_bytes("name: Gönen".encode("latin-1"))
    with pytest.raises(ScenarioError, match="utf-8"):
        load_scenario(tmp_path / "latin.yaml")
    with pytest.raises(ScenarioError, match="No such file"):
        load_scenario("hihger")


def test_relative_models_start_in_the_scenario_s_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "climbs"
    folder.mkdir()
    (folder / "mine.urdf").write_text("<robot name='mine'/>")
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(edited((*ROBOT, "model"), "mine.urdf")))
    assert load_scenario(path).model_path(0) == folder / "mine.urdf"
    monkeypatch.chdir(tmp_path)
    scenario = load_scenario(Path("climbs/mine.yaml"))
    monkeypatch.chdir(folder)
    assert scenario.model_path(0) == folder / "mine.urdf"


# Against the robot


def against_robot(tree: object) -> ScenarioError:
    with pytest.raises(ScenarioError) as caught:
        check_against_robot(load(tree), 0, LIMBS, LIMITS)
    return caught.value


def test_a_scenario_that_fits_its_robot_passes() -> None:
    check_against_robot(load(BASE), 0, LIMBS, LIMITS)


def test_a_planar_robot_has_nothing_to_do_with_regions_of_space() -> None:
    ball = {"sphere": {"center": [0.2, 0.1, 0.0], "radius": 0.05}}
    for path, field in (
        (("wall", "obstacles", 1), "wall.obstacles[1]"),
        ((*ROBOT, "goal", "pelvis"), "robots[0].goal.pelvis"),
        ((*ROBOT, "waypoints", 0, "pelvis"), "robots[0].waypoints[0].pelvis"),
        ((*ROBOT, "avoid", "regions", 0), "robots[0].avoid.regions[0]"),
    ):
        error = against_robot(edited(path, ball))
        assert error.path == field
        assert "given 'sphere'; allowed: circle or polygon, for quadruped" in str(error)
        check_against_robot(load(edited(path, ball)), 0, LIMBS, LIMITS, planar=False)


def test_a_planar_robot_stands_on_holds_in_its_plane() -> None:
    hold = ("wall", "holds", 1)
    for field, value in (("position", [0.1, 0.2, 0.03]), ("normal", [0.0, 1.0, 0.2])):
        error = against_robot(edited((*hold, field), value))
        assert error.path == f"wall.holds[1].{field}"
        assert "with z = 0, for quadruped moves in the plane z = 0 only" in str(error)
        check_against_robot(load(edited((*hold, field), value)), 0, LIMBS, LIMITS, planar=False)


def test_a_pin_may_stick_out_of_the_wall_whoever_hangs_on_it() -> None:
    pin = {"position": [0.1, 0.2], "normal": [0.0, 0.0, 1.0], "grip": "pin"}
    check_against_robot(load(edited(("wall", "holds", 1), pin)), 0, LIMBS, LIMITS)


def test_a_planar_robot_moves_in_front_of_every_facet() -> None:
    behind, before = edited(FACETS, [{"corners": SLAB}]), [[5.0, 5.0, -1.0], [6.0, 5.0, 0.5], [5.0, 6.0, 0.5]]
    check_against_robot(load(behind), 0, LIMBS, LIMITS)
    error = against_robot(edited(FACETS, [{"corners": SLAB}, {"corners": before}]))
    assert error.path == "wall.facets[1].corners"


@pytest.mark.parametrize(
    ("path", "value", "field", "allowed"),
    [
        (("start",), {"right_fron": 3, "left_front": 1}, "start.right_fron", "did you mean right_front?"),
        (("start",), {"right_front": 3, "left_front": 1, "left_rear": 0}, "start.right_rear", "every limb"),
        (("goal",), {"holds": [1, 2, 3]}, "goal.holds", "4 holds"),
        (("goal",), {"stance": {"right_front": 3}}, "goal.stance.left_front", "every limb"),
        (("waypoints",), [{"stance": {"tail": 3}}], "waypoints[0].stance.tail", "no limb of this name"),
        (("start_posture",), {"right_front_hop": 0.1}, "start_posture.right_front_hop", "right_front_hip?"),
        (("start_posture",), {"right_front_hip": 2.2}, "start_posture.right_front_hip", "-2.1 to 2.1 rad"),
        (("start_posture",), {"right_front_hip": -2.2}, "start_posture.right_front_hip", "-2.1 to 2.1 rad"),
    ],
)
def test_limbs_and_joints_must_be_the_robot_s(path: tuple[str, ...], value: object, field: str, allowed: str) -> None:
    error = against_robot(edited((*ROBOT, *path), value))
    assert error.path == f"robots[0].{field}"
    assert allowed in str(error)


def test_errors_survive_the_way_back_from_a_worker() -> None:
    error = ScenarioError.at("a.yaml", "seed", -1, "a whole number")
    again = pickle.loads(pickle.dumps(error))
    assert isinstance(again, ScenarioError)
    assert (str(again), again.file, again.path, again.given, again.allowed) == (
        str(error),
        "a.yaml",
        "seed",
        "-1",
        "a whole number",
    )
    nothing = NoPlanFound("gave up", proved=True, counts={"moves": 2})
    again = pickle.loads(pickle.dumps(nothing))
    assert isinstance(again, NoPlanFound) and str(again) == "gave up" and vars(again) == vars(nothing)


# Whatever is in the file, it is read or refused


def paths(node: object, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    items: list[tuple[Any, Any]] = []
    if isinstance(node, dict):
        items = list(node.items())
    elif isinstance(node, list):
        items = list(enumerate(node))
    here = [path] if path else []
    return here + [found for key, value in items for found in paths(value, (*path, key))]


ANYTHING = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=8)
    | st.dates()
    | st.binary(max_size=4)
    | st.sampled_from(["_tag", "circle", "1e3", "package://climber/", "package://climber/../..", "-"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6) | st.integers(), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(paths(BASE)), ANYTHING)
def test_a_file_with_anything_anywhere_is_read_or_refused(path: tuple[str | int, ...], value: object) -> None:
    text = yaml.safe_dump(edited(path, value), allow_unicode=True)
    try:
        scenario = scenario_from_text(text, "wall.yaml")
    except ScenarioError as error:
        assert error.file == "wall.yaml"
    else:
        scenario.build_wall()


@settings(max_examples=200, deadline=None)
@given(st.text(alphabet=st.sampled_from(list("ab:{}[],-&*!|>'\"#\n \t1.e%@?<")), max_size=40) | st.text(max_size=30))
def test_any_text_is_read_or_refused(text: str) -> None:
    with pytest.raises(ScenarioError):
        scenario_from_text(text, "wall.yaml")


@settings(max_examples=100, deadline=None)
@given(
    st.floats(-10, 10),
    st.floats(-10, 10),
    st.floats(0, 2 * math.pi),
    st.floats(1e-6, 1e6),
    st.floats(0, 5),
    st.floats(0, 1),
)
def test_numbers_come_through_exactly(
    x: float, y: float, angle: float, length: float, mu: float, half_width: float
) -> None:
    hold = {
        "position": [x, y],
        "normal": [length * math.cos(angle), length * math.sin(angle)],
        "friction": mu,
        "half_width": half_width,
    }
    built = load(edited(HOLD, hold)).build_wall().holds[3]
    assert built.position == (x, y, 0.0)
    assert (built.friction, built.half_width) == (mu, half_width)
    np.testing.assert_allclose(built.normal, [math.cos(angle), math.sin(angle), 0.0], atol=1e-9)
