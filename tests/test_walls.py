"""Random walls are what their recipe says, and climbs on them can at least be hoped for."""

from __future__ import annotations

import json
import math
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
from climber.random_scenario import find_climb, scenario_text
from climber.random_wall import Recipe, Spread, hold_specs, make_wall, scatter
from climber.robot import Robot
from climber.scenario import load_scenario, scenario_from_text
from climber.stance import Contact, Stance
from climber.transitions import TransitionFinder
from climber.wall_command import MODEL

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
        "# Made by: climber wall --holds 40 --seed 2 --friction 0.7 0.05 --half-width 0 --out forty.yaml\n"
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
