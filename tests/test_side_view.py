"""The picture of a wall from the side shows how it leans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from climber.draw import wall_picture
from climber.random_scenario import RandomClimb, scenario_text
from climber.scenario import CircleSpec, load_scenario, scenario_from_text
from climber.side_view import SideView
from climber.solids import Sphere
from climber.svg import SvgCanvas
from climber.wall_command import SPACE_MODEL
from climber.wall_kinds import KINDS, make_wall


@pytest.mark.parametrize(("kind", "lean"), [("slab", -30.0), ("vertical", 0.0), ("overhang", 20.0), ("board", 40.0)])
def test_walls_lean_towards_the_climber_on_the_right_as_much_as_they_do(kind: str, lean: float) -> None:
    wall = make_wall(replace(KINDS[kind], **({} if kind == "board" else {"holds": 30})))
    side = SideView(wall)
    up_the_wall, out_of_it = side.seen(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    assert np.degrees(np.arctan2(*up_the_wall)) == pytest.approx(lean)
    assert out_of_it[0] > 0.0
    np.testing.assert_allclose(side.seen(wall.gravity), [0.0, -9.81], atol=1e-9)
    assert (side.seen(wall.positions) > side.lower).all() and (side.seen(wall.positions) < side.upper).all()


def test_only_walls_in_space_are_shown_from_the_side() -> None:
    assert not SideView.worthwhile(make_wall(replace(KINDS["plane"], holds=5)))
    assert SideView.worthwhile(make_wall(replace(KINDS["slab"], holds=5)))
    assert "from the side" not in document(wall_picture(load_scenario("basic")))


def test_rock_and_obstacles_and_every_hold_are_in_the_picture_of_a_wall() -> None:
    recipe = replace(KINDS["overhang"], holds=30)
    limbs = ("right_front", "left_front", "left_rear", "right_rear")
    climb = RandomClimb(dict(zip(limbs, range(4), strict=True)), CircleSpec([0.5, 1.0], 0.06), 9)
    text = scenario_text(recipe, SPACE_MODEL, climb, "there", "a test")
    text = text.replace("robots:\n", "  obstacles: [{sphere: {center: [0.5, 0.5, 0.2], radius: 0.05}}]\nrobots:\n", 1)
    scenario = scenario_from_text(text)
    assert scenario.build_wall().solids == (Sphere((0.5, 0.5, 0.2), 0.05),)
    shown = document(wall_picture(scenario))
    part = shown[shown.index("<title>seen from the side</title>") :].split("</g>")[0]
    assert part.count("<circle") == 30
    assert part.count("<polygon") == 3  # the rock, the obstacle and the frame
    assert "from the side" in part


def document(canvas: object) -> str:
    assert isinstance(canvas, SvgCanvas)
    return canvas.document()
