"""Pictures of a climb in space: seen from the front, its support polygons below it on the page."""

from __future__ import annotations

import base64
import re
from pathlib import Path

import numpy as np
from plans_space import climb_plan

from climber.canvas import View
from climber.draw import draw_climb, draw_wall
from climber.meshcat_page import meshcat_page
from climber.meshcat_space import slab_of
from climber.picture import paint_wall
from climber.scenario import scenario_from_text
from climber.scene import Scene
from climber.svg import SvgCanvas
from climber.verify_equilibrium import support_of


def test_support_is_the_polygon_that_verify_finds() -> None:
    scene = Scene.of(climb_plan())
    (climb,) = scene.climbs
    assert climb.polygons is not None
    for phase, corners, ends in zip(climb.plan.phases, climb.polygons, climb.support, strict=True):
        holds, points = [c.hold for c in phase.contacts], np.array([c.point for c in phase.contacts])
        theirs = support_of(scene.wall, holds, points, climb.robot.mass, planar=False)
        assert np.abs(theirs.margin(corners)).max() < 2e-3
        assert theirs.margin(corners.mean(axis=0)[None])[0] > 0.02
        np.testing.assert_allclose(ends, [corners[:, 0].min(), corners[:, 0].max()])


def test_a_sheet_lies_across_gravity_at_its_level() -> None:
    up, polygon = np.array([0.0, 0.6, 0.8]), np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.8, -0.6]])
    vertices, triangles = slab_of(polygon, up, -0.3)
    np.testing.assert_allclose(up @ vertices, -0.3)
    np.testing.assert_allclose(vertices.T - polygon, np.outer([-0.3] * 3, up), atol=1e-12)
    assert {tuple(sorted(triangle)) for triangle in triangles.T} == {(0, 1, 2)}


def test_pictures_show_solids_and_the_edges_of_facets(tmp_path: Path) -> None:
    scenario = scenario_from_text(climb_plan().scenario_text)
    draw_wall(scenario, tmp_path / "wall.svg")
    draw_climb(climb_plan(), tmp_path / "climb.svg")
    assert "obstacle" in (tmp_path / "wall.svg").read_text()
    wall = scenario.build_wall()
    wide, narrow = SvgCanvas(800, 800, "wide"), SvgCanvas(800, 800, "narrow")
    paint_wall(wide, View((-1.1, -1.1), (1.1, 1.1), 0.0, 0.0, 300.0), wall)
    paint_wall(narrow, View((-0.9, -0.9), (0.9, 0.9), 0.0, 0.0, 300.0), wall)  # the facet's edges are out of sight
    count = [canvas.document().count("<polyline") for canvas in (wide, narrow)]
    assert count[0] == count[1] + 1


def test_the_page_has_rock_holds_and_support() -> None:
    scene = Scene.of(climb_plan())
    page = meshcat_page(scene)
    shown = b" ".join(base64.b64decode(blob) for blob in re.findall(r'octet-binary;base64,([^"]+)"', page))
    for number in range(len(scene.wall.holds)):
        assert f"/climb/wall/hold_{number}/cone".encode() in shown
    for number in range(2):  # one facet, one ball
        assert f"/climb/wall/rock_{number}".encode() in shown
    for sheet in ("0_0", "1_0", "1_1", "2_0"):  # with all limbs on, and in the swing without the one
        assert f"/climb/support/0/{sheet}".encode() in shown
    assert b"/climb/support/0/0_1" not in shown
