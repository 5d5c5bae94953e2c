"""Random walls are what their recipe says, and climbs on them can at least be hoped for."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import pdist

from climber.cli import main
from climber.exceptions import ClimberError
from climber.graph import build_stance_graph
from climber.manifold import Body
from climber.random_scenario import RandomClimb, find_climb, scenario_text
from climber.random_wall import Recipe, Spread, scatter
from climber.robot import Robot
from climber.scenario import CircleSpec, load_scenario, scenario_from_text
from climber.stance import Contact, Stance
from climber.transitions import TransitionFinder
from climber.wall_command import MODEL, SPACE_MODEL, add_wall_command, recipe_of
from climber.wall_kinds import KINDS, hold_specs, make_wall, off_problem

recipes = st.builds(
    Recipe,
    holds=st.integers(1, 120),
    seed=st.integers(0, 2**31),
    density=st.floats(10.0, 60.0),
    spacing=st.floats(0.0, 0.09),
    aspect=st.floats(0.25, 4.0),
    friction=st.builds(Spread, st.floats(0.3, 1.0), st.floats(0.0, 0.5), st.just(0.2), st.just(1.1)),
    slope=st.builds(Spread, st.just(0.0), st.floats(0.0, 60.0), st.just(-50.0), st.just(50.0)),
)


@settings(deadline=None, max_examples=40)
@given(recipes)
def test_holds_keep_their_spacing_and_fill_the_wall_at_the_density(recipe: Recipe) -> None:
    points = scatter(np.random.default_rng(recipe.seed), recipe)
    width, height = recipe.size
    assert points.shape == (recipe.holds, 2)
    assert recipe.holds / (width * height) == pytest.approx(recipe.density)
    assert height / width == pytest.approx(recipe.aspect)
    assert (points >= 0).all() and (points <= np.array([width, height]) + 1e-4).all()
    assert (np.diff(points[:, 1]) >= 0).all()  # the lowest first
    if recipe.holds > 1:
        assert pdist(points).min() >= recipe.spacing - 1e-12


@settings(deadline=None, max_examples=25)
@given(recipes)
def test_friction_and_slopes_stay_where_they_are_clipped(recipe: Recipe) -> None:
    wall = make_wall(recipe)
    friction = np.array([hold.friction for hold in wall.holds])
    slope = np.degrees(np.arctan2(-wall.normals[:, 0], wall.normals[:, 1]))
    assert recipe.friction.lower - 5e-4 <= friction.min() and friction.max() <= recipe.friction.upper + 5e-4
    assert np.abs(slope).max() <= recipe.slope.upper + 1e-3
    assert {hold.half_width for hold in wall.holds} == {recipe.half_width}


def test_friction_and_slopes_are_spread_as_asked() -> None:
    wall = make_wall(
        Recipe(holds=4000, spacing=0.0, friction=Spread(0.6, 0.05, 0.0, 9.0), slope=Spread(10, 5, -90, 90))
    )
    friction = np.array([hold.friction for hold in wall.holds])
    slope = np.degrees(np.arctan2(-wall.normals[:, 0], wall.normals[:, 1]))
    assert friction.mean() == pytest.approx(0.6, abs=0.005) and friction.std() == pytest.approx(0.05, rel=0.05)
    assert slope.mean() == pytest.approx(10.0, abs=0.4) and slope.std() == pytest.approx(5.0, rel=0.05)


def test_holds_do_not_gather_anywhere() -> None:
    recipe = Recipe(holds=4000, spacing=0.08)
    points = scatter(np.random.default_rng(3), recipe)
    width, height = recipe.size
    counts = np.histogram2d(*points.T, bins=4, range=[[0, width], [0, height]])[0]
    assert counts.sum() == 4000
    # Hard discs are more even than a Poisson process, whose counts would vary by sqrt(250) = 16.
    assert counts.std() < 16.0 and np.abs(counts - 250).max() < 40


def test_a_seed_is_a_wall_and_another_seed_another() -> None:
    assert make_wall(Recipe(seed=5)) == make_wall(Recipe(seed=5))
    assert make_wall(Recipe(seed=5)) != make_wall(Recipe(seed=6))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"holds": 0}, "holds is 0"),
        ({"density": -1.0}, "density is -1"),
        ({"aspect": math.nan}, "aspect is nan"),
        ({"spacing": -0.1}, "spacing is -0.1"),
        ({"spacing": 0.25}, "cannot be 0.25 m apart: at most"),
        ({"spacing": 0.17}, "large random walls are full at 55 %"),
        ({"min_force": 30.0}, "at most max_force"),
        ({"friction": Spread(0.5, -0.1, 0.0, 1.0)}, "friction deviation is -0.1"),
        ({"friction": Spread(0.5, 0.1, 0.9, 0.3)}, "friction is clipped to 0.9 ... 0.3"),
        ({"slope": Spread(0.0, 10.0, -200.0, 200.0)}, "half a turn"),
        ({"inclination_deg": 180.0}, "between 0 and 180"),
    ],
)
def test_a_recipe_that_makes_no_wall_says_why(changes: dict, message: str) -> None:
    with pytest.raises(ClimberError, match=message):
        make_wall(Recipe(**changes))


def test_the_bound_on_room_refuses_nothing_that_fits() -> None:
    """A triangular grid, the closest that points can be, is let through; a tenth closer is not."""
    spacing, rows = 0.1, 30
    width, height = spacing * (rows - 1), spacing * math.sqrt(3) / 2 * (rows - 1)
    fits = rows * rows - rows // 2
    recipe = Recipe(holds=fits, density=fits / (width * height), aspect=height / width, spacing=spacing)
    recipe.check()
    with pytest.raises(ClimberError, match="cannot be"):
        Recipe(holds=fits, density=recipe.density, aspect=recipe.aspect, spacing=1.1 * spacing).check()


@settings(deadline=None, max_examples=3, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, 10_000))
def test_a_climb_starts_where_the_robot_can_be_held_and_the_graph_leads_to_its_goal(seed: int) -> None:
    recipe = Recipe(holds=40, seed=seed)
    try:
        climb = find_climb(recipe, MODEL)
    except ClimberError as error:
        assert "take another seed" in str(error)
        return
    scenario = scenario_from_text(scenario_text(recipe, MODEL, climb, "forty", "a test"))
    wall, robot = scenario.build_wall(), Robot(MODEL)
    assert wall == make_wall(recipe)
    start = Stance(tuple(scenario.robots[0].start[name] for name in robot.limb_names))
    finder = TransitionFinder(Body(robot, wall), np.random.default_rng(0))
    assert finder.standing(tuple(Contact(limb, hold) for limb, hold in enumerate(start.holds))).failure is None
    graph = build_stance_graph(wall, robot, start, scenario.cost)
    goal = scenario.robots[0].goal.pelvis
    assert goal is not None
    assert len(graph.goal_vertices(region=goal.inside())) > 0
    assert climb.moves >= 1
    # From the lower half to the upper half.
    assert wall.positions[list(start.holds), 1].mean() < recipe.size[1] / 2
    assert goal.circle is not None and goal.circle.center[1] > recipe.size[1] / 2


def test_the_command_writes_the_same_scenario_again_and_says_how(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    options = ["--holds", "40", "--seed", "2", "--friction", "0.7", "0.05", "--half-width", "0", "--json"]
    for folder in ("a", "b"):
        assert main(["wall", *options, "--out", str(tmp_path / folder / "forty.yaml")]) == 0
    text = (tmp_path / "a" / "forty.yaml").read_text()
    assert text == (tmp_path / "b" / "forty.yaml").read_text()
    assert text.startswith(
        "# Made by: climber wall --holds 40 --seed 2 --half-width 0 --friction 0.7 0.05 --out forty.yaml\n"
    )
    facts = json.loads(capsys.readouterr().out.splitlines()[0])
    scenario = load_scenario(tmp_path / "a" / "forty.yaml")
    assert scenario.name == "forty" and len(scenario.wall.holds) == facts["holds"] == 40
    assert scenario.robots[0].start == facts["start"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--holds", "100", "--spacing", "0.5"], "cannot be 0.5 m apart"),
        (["--holds", "2"], "no room for a climb"),
        (
            ["--holds", "60", "--slope", "0", "--friction", "0", "0", "--friction-limits", "0", "0", "--density", "4"],
            "take",
        ),
        (["--holds", "40", "--model", "no-such.urdf"], "no-such.urdf"),
        (["--holds", "40", "--gap", "0.5"], "--gap is given for a wall of kind plane; allowed: chimney"),
        (
            ["--kind", "slab", "--holds", "40", "--angle", "90"],
            "--angle is given for a wall of kind slab; allowed: ins",
        ),
        (["--kind", "board", "--holds", "40"], "--holds is given for a wall of kind board; allowed: plane, slab"),
    ],
)
def test_a_wall_that_cannot_be_made_is_exit_code_two_and_no_file(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    out = tmp_path / "wall.yaml"
    assert main(["wall", *options, "--out", str(out)]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("number", [100, 1000])
def test_the_walls_that_come_along_are_what_the_command_on_top_makes(number: int) -> None:
    scenario = load_scenario(f"random_{number}")
    seed = 3 if number == 100 else 1
    first = scenario.source.splitlines()[0]
    assert first == f"# Made by: climber wall --holds {number} --seed {seed} --half-width 0 --out random_{number}.yaml"
    recipe = Recipe(holds=number, seed=seed, half_width=0.0)
    assert scenario.wall.holds == hold_specs(recipe)
    assert len(scenario.source) < 1_000_000


# Walls in space

SPACE_KINDS = sorted(set(KINDS) - {"plane"})


def space_recipe(kind: str, seed: int = 0) -> Recipe:
    return replace(KINDS[kind], seed=seed) if kind == "board" else replace(KINDS[kind], seed=seed, holds=60)


@pytest.mark.parametrize("kind", SPACE_KINDS)
@settings(deadline=None, max_examples=5)
@given(seed=st.integers(0, 10_000))
def test_holds_of_a_wall_in_space_stick_out_of_its_surface(kind: str, seed: int) -> None:
    recipe = space_recipe(kind, seed)
    wall = make_wall(recipe)
    assert len(wall.holds) == recipe.holds
    np.testing.assert_allclose(np.linalg.norm(wall.normals, axis=1), 1.0, atol=1e-12)
    away = np.array([facet.solid.distance(wall.positions) for facet in wall.facets])
    assert recipe.standoff - 2e-4 <= away.min()
    assert away.min(axis=0).max() <= 1.05 * recipe.standoff  # a little more beside the edge of an outside corner
    assert (np.diff(wall.positions[:, 1]) >= 0).all()  # the lowest first
    assert wall == make_wall(recipe) != make_wall(replace(recipe, seed=seed + 1))


@pytest.mark.parametrize("kind", ["slab", "vertical", "overhang", "inside_corner", "outside_corner", "board"])
def test_holds_are_ledges_turned_into_the_wall_by_their_incut(kind: str) -> None:
    recipe = replace(space_recipe(kind), slope=Spread(0.0, 0.0, 0.0, 0.0), incut=Spread(10.0, 0.0, 0.0, 90.0))
    wall = make_wall(recipe)
    against_gravity = -wall.gravity / np.linalg.norm(wall.gravity)
    np.testing.assert_allclose(wall.normals @ against_gravity, np.cos(np.radians(10.0)), atol=1e-5)
    level = make_wall(replace(recipe, incut=Spread(0.0, 0.0, 0.0, 0.0)))
    np.testing.assert_allclose(level.normals, np.broadcast_to(against_gravity, level.normals.shape), atol=2e-6)
    # Incut is towards the rock.
    assert ((wall.normals - level.normals) * wall.outward).sum(axis=1).max() < -0.05


def test_holds_of_a_chimney_only_bear_what_presses_outward() -> None:
    wall = make_wall(space_recipe("chimney"))
    left = wall.positions[:, 0] < 0.3
    assert left.sum() == 30
    np.testing.assert_allclose(wall.positions[:, 0], np.where(left, 0.0, 0.6), atol=1e-9)
    np.testing.assert_allclose(wall.outward, np.where(left, 1.0, -1.0)[:, None] * [1.0, 0.0, 0.0], atol=1e-9)
    assert (wall.normals * wall.outward).sum(axis=1).min() > np.cos(np.radians(10.1))
    assert np.abs(wall.positions[:, 2]).max() <= 0.06 + 1e-9
    for side in (left, ~left):  # rungs of a ladder
        gaps = np.diff(wall.positions[side, 1])
        assert gaps.max() < 1.7 * gaps.mean() < 0.3


def test_corners_have_the_angle_that_is_asked_for_and_meet_in_an_edge() -> None:
    for kind in ("inside_corner", "outside_corner"):
        left, right = make_wall(replace(space_recipe(kind), angle_deg=120.0)).facets
        assert float(left.normal @ right.normal) == pytest.approx(0.5, abs=1e-5)
        shared = set(left.corners) & set(right.corners)
        assert len(shared) == 2
        # Inside, the sides face one another.
        between = np.mean(right.corners, axis=0) - np.mean(left.corners, axis=0)
        assert (float(left.normal @ between) > 0) == (kind == "inside_corner")


def test_a_board_is_a_grid_that_leans_and_its_problem_sparse() -> None:
    recipe = space_recipe("board", 4)
    wall = make_wall(recipe)
    assert len(wall.holds) == 198
    assert wall.inclination_deg == 130.0
    x, y = np.unique(wall.positions[:, 0]), np.unique(wall.positions[:, 1])
    assert (len(x), len(y)) == (11, 18)
    np.testing.assert_allclose(np.diff(x), 0.2)
    np.testing.assert_allclose(np.diff(y), 0.2)
    kept = np.setdiff1d(np.arange(198), off_problem(recipe))
    assert (np.bincount(kept // 11) == recipe.problem).all()
    assert off_problem(recipe) != off_problem(replace(recipe, seed=5))
    assert off_problem(replace(recipe, problem=11)) == off_problem(space_recipe("slab")) == []


@pytest.mark.parametrize("kind", SPACE_KINDS)
def test_the_scenario_of_a_wall_in_space_is_that_wall(kind: str) -> None:
    recipe = space_recipe(kind, 3)
    limbs = ("right_front", "left_front", "left_rear", "right_rear")
    climb = RandomClimb(dict(zip(limbs, range(4), strict=True)), CircleSpec([0.5, 1.5], 0.06), 9)
    if kind == "board":
        climb = replace(
            climb, start=dict(zip(limbs, sorted(set(range(198)) - set(off_problem(recipe)))[:4], strict=True))
        )
    scenario = scenario_from_text(scenario_text(recipe, SPACE_MODEL, climb, "there", "a test"))
    assert scenario.build_wall() == make_wall(recipe)
    assert scenario.robots[0].avoid.holds == off_problem(recipe)
    assert len(scenario.source) < 100_000


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "roof"}, "kind is 'roof'; allowed: plane, slab"),
        ({"kind": "slab", "standoff": 0.0}, "standoff is 0 m"),
        ({"kind": "outside_corner", "angle_deg": 60.0}, "angle is 60 degrees"),
        ({"kind": "chimney", "gap": 0.0}, "gap is 0 m"),
        ({"kind": "board", "holds": 100}, "holds is 100; allowed: 198"),
        ({"kind": "board", "holds": 198, "problem": 0}, "problem is 0"),
        ({"kind": "slab", "incut": Spread(0.0, -1.0, 0.0, 1.0)}, "incut deviation is -1"),
        ({"kind": "slab", "spacing": 0.17}, "found a place"),
    ],
)
def test_a_recipe_in_space_that_makes_no_wall_says_why(changes: dict, message: str) -> None:
    with pytest.raises(ClimberError, match=message):
        make_wall(replace(Recipe(), **changes))


def test_options_replace_what_the_kind_of_wall_has() -> None:
    def recipe(*words: str) -> Recipe:
        parser = argparse.ArgumentParser()
        add_wall_command(parser.add_subparsers())
        return recipe_of(parser.parse_args(["wall", "--out", "there.yaml", *words]))

    assert recipe("--kind", "slab", "--holds", "100") == KINDS["slab"]
    assert recipe("--kind", "board") == KINDS["board"]
    assert recipe("--holds", "100") == Recipe()
    words = "--kind inside_corner --holds 9 --angle 120 --incut 3 2 --friction-limits 0 1 --steepest 5"
    changed = recipe(*words.split())
    spread = KINDS["inside_corner"]
    assert changed == replace(
        spread,
        holds=9,
        angle_deg=120.0,
        incut=replace(spread.incut, mean=3.0, deviation=2.0),
        friction=replace(spread.friction, lower=0.0, upper=1.0),
        slope=replace(spread.slope, lower=-5.0, upper=5.0),
    )
    with pytest.raises(ClimberError, match="--holds is not given"):
        recipe("--kind", "slab")
