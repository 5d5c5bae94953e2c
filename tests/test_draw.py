"""Pictures of plans: files that are whole, and that show what the plan says."""

from __future__ import annotations

import base64
import re
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image, ImageColor
from plans import step_plan
from pydrake.math import RigidTransform
from shapely.geometry import Polygon

from climber import animation, draw, gif, meshcat_page, picture
from climber.canvas import Canvas, View, dashes
from climber.exceptions import PlanFileError
from climber.plan_file import Plan
from climber.programs.equilibrium import SupportProgram
from climber.raster import RasterCanvas
from climber.replay import Replay
from climber.robot import Robot
from climber.scenario import AvoidSpec, Scenario, scenario_from_text
from climber.scene import Scene
from climber.silhouette import LIMB_COLORS, Silhouette
from climber.stance import Contact
from climber.svg import SvgCanvas
from climber.wall import Hold, Wall, circle

SVG = "{http://www.w3.org/2000/svg}"


DURATION = 0.4  # of each of the plan's three phases [s]

ASKED = """\
name: what is asked
wall:
  hold_defaults: {friction: 0.6}
  holds:
  - {position: [0.13, 0.15], normal: [-0.1, 1.0], friction: 0.55}
  - {position: [-0.12, 0.16], normal: [0.2, 1.0]}
  - {position: [-0.13, -0.14], normal: [0.1, 1.0]}
  - {position: [0.12, -0.15], normal: [-0.15, 1.0]}
  - {position: [0.14, 0.22], normal: [0.0, 1.0], grip: magnet, adhesion: 4.0}
  - {position: [0.30, 0.30], normal: [0.0, 1.0], grip: pin}
  obstacles:
  - circle: {center: [0.0, 0.16], radius: 0.02}
  - polygon: {vertices: [[0.26, -0.1], [0.40, -0.1], [0.40, 0.1], [0.33, 0.05]]}
robots:
- name: quadruped
  model: package://climber/quadruped/quadruped.urdf
  start: {right_front: 0, left_front: 1, left_rear: 2, right_rear: 3}
  goal:
    stance: {right_front: 4, left_front: 1, left_rear: 2, right_rear: 3}
    pelvis: {circle: {center: [0.0, 0.02], radius: 0.03}}
  waypoints:
  - {name: on the way, holds: [0, 1, 2, 3]}
  - {pelvis: {polygon: {vertices: [[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]]}}}
  avoid:
    holds: [5]
    regions: [{circle: {center: [0.35, 0.2], radius: 0.04}}]
"""


@pytest.fixture(scope="module")
def asked() -> Scenario:
    return scenario_from_text(ASKED)


@pytest.fixture(scope="module")
def plan() -> Plan:
    return step_plan(duration=DURATION)


@pytest.fixture(scope="module")
def scene(plan: Plan) -> Scene:
    return Scene.of(plan)


@pytest.fixture(scope="module")
def pair(scene: Scene) -> Scene:
    """The same climb by two robots of different names at different times."""
    climb = scene.climbs[0]
    later = tuple(replace(phase, time=phase.time + 0.3) for phase in climb.plan.phases)
    second = Replay(scene.wall, replace(climb.plan, name="second", phases=later), climb.robot)
    return replace(scene, climbs=(climb, second))


def texts(document: str) -> list[str]:
    return [element.text or "" for element in ElementTree.fromstring(document).iter(SVG + "text")]


def document_of(canvas: Canvas) -> str:
    assert isinstance(canvas, SvgCanvas)
    return canvas.document()


def titles(document: str) -> list[str]:
    return [element.text or "" for element in ElementTree.fromstring(document).iter(SVG + "title")]


# --- the wall ---------------------------------------------------------------------------------------------------------


def test_wall_shows_every_hold_with_its_number(asked: Scenario, tmp_path: Path) -> None:
    draw.draw_wall(asked, tmp_path / "wall.svg")
    document = (tmp_path / "wall.svg").read_text()
    for number, hold in enumerate(asked.build_wall().holds):
        assert str(number) in texts(document)
        assert f"hold {number}: {hold.grip}, friction {hold.friction:g}" in titles(document)


def test_wall_shows_all_that_is_asked(asked: Scenario) -> None:
    shown = titles(document_of(draw.wall_picture(asked)))
    assert shown.count("obstacle") == 2
    for limb, hold in asked.robots[0].start.items():
        assert f"quadruped: {limb} starts on hold {hold}" in shown
        assert f"hold {hold}: on the way" in shown
    assert "goal" in shown
    assert "hold 4: goal of right_front" in shown
    assert "waypoint 2" in shown
    assert "quadruped: hold 5 is to be avoided" in shown
    assert "region to keep out of" in shown


def test_legend_names_each_kind_that_is_there_and_no_other(asked: Scenario, scene: Scene) -> None:
    words = texts(document_of(draw.wall_picture(asked)))
    for word in (
        "hold, friction cone",
        "pin",
        "magnet, friction cone",
        "obstacle",
        "goal hold",
        "hold to avoid",
        "keep out",
    ):
        assert words.count(word) == 1, word
    plain = scene.scenario.robots[0]
    few = replace(scene.scenario, robots=[replace(plain, waypoints=[], avoid=AvoidSpec())])
    words = texts(document_of(draw.wall_picture(few)))
    assert not {"pin", "hold to avoid", "keep out", "waypoint hold"} & set(words)


def test_wall_axes_have_the_same_scale(asked: Scenario) -> None:
    root = ElementTree.fromstring(document_of(draw.wall_picture(asked)))
    axes = next(group for group in root.iter(SVG + "g") if group[0].text == "axes in metres")
    ticks = [
        (float(e.get("x", 0)), float(e.get("y", 0)), str(e.text), e.get("text-anchor")) for e in axes.iter(SVG + "text")
    ]
    along = sorted((float(text), x) for x, _, text, anchor in ticks if anchor == "middle" and "[" not in text)
    up = sorted((float(text), y) for _, y, text, anchor in ticks if anchor == "end")
    (x0, px0), (x1, px1) = along[0], along[-1]
    (y0, py0), (y1, py1) = up[0], up[-1]
    assert (px1 - px0) / (x1 - x0) == pytest.approx(-(py1 - py0) / (y1 - y0), rel=1e-3)


@given(st.floats(0.01, 3.0), st.floats(-np.pi, np.pi))
def test_cone_opens_by_the_angle_of_friction_about_the_normal(friction: float, angle: float) -> None:
    hold = Hold((0.3, -0.2, 0.0), (np.cos(angle), np.sin(angle), 0.0), friction)
    outline = picture.wedge(hold)
    edges = (outline[[1, -1]] - outline[0]) / picture.CONE_LENGTH
    assert outline[0] == pytest.approx(hold.position[:2])
    normal = np.array(hold.normal[:2])
    assert edges @ normal == pytest.approx(np.cos(np.arctan(friction)) * np.ones(2))
    assert edges[0] + edges[1] == pytest.approx(2.0 * np.cos(np.arctan(friction)) * normal)


def test_pin_is_a_disk_since_it_pulls_every_way() -> None:
    outline = picture.wedge(Hold((0.1, 0.2, 0.0), (0.0, 1.0, 0.0), 0.5, grip="pin"))
    assert np.ptp(np.linalg.norm(outline - [0.1, 0.2], axis=1)) < 1e-12


@given(st.floats(0.03, 50.0))
def test_ticks_are_round_and_neither_crowded_nor_few(length: float) -> None:
    step = picture.tick_step(length)
    assert 4.0 <= length / step <= 10.0 + 1e-9
    first_digit = step / 10.0 ** np.floor(np.log10(step) + 1e-9)
    assert min(abs(first_digit - digit) for digit in (1, 2, 5)) < 1e-9


# --- the climb --------------------------------------------------------------------------------------------------------


def test_climb_has_a_panel_for_the_start_every_move_and_the_end(plan: Plan, tmp_path: Path) -> None:
    draw.draw_climb(plan, tmp_path / "climb.svg")
    document = (tmp_path / "climb.svg").read_text()
    panels = [title for title in titles(document) if re.search(r", at \d", title)]
    assert panels == [
        "start, at 0.00 s",
        "move 1 of 1: right front, hold 0 to 4, at 0.40 s",
        "end, at 1.20 s",
    ]
    assert texts(document).count("3") == 2 * len(panels)  # each number once as halo and once as ink


def test_png_is_the_same_picture_as_the_svg(scene: Scene, tmp_path: Path) -> None:
    draw.draw_climb(scene, tmp_path / "climb.png")
    canvas = draw.climb_picture(scene)
    assert isinstance(canvas, SvgCanvas)
    with Image.open(tmp_path / "climb.png") as image:
        assert image.size == (2 * np.ceil(canvas.width), 2 * np.ceil(canvas.height))
        shown = np.unique(np.asarray(image.convert("RGB")).reshape(-1, 3), axis=0)
    for color in scene.climbs[0].looks.limb_colors:
        assert (shown == ImageColor.getrgb(color)).all(axis=1).any()


def test_support_bands_are_the_intervals_of_the_contacts(scene: Scene) -> None:
    climb = scene.climbs[0]
    for place, phase in enumerate(climb.plan.phases):
        contacts = [Contact(climb.robot.limb_names.index(c.limb), c.hold) for c in phase.contacts]
        interval = SupportProgram.of_contacts(scene.wall, contacts, climb.robot.mass).solve()
        assert climb.support[place] == pytest.approx([interval.lower, interval.upper], abs=1e-6)
    assert climb.standing_support(1) == pytest.approx(climb.support[0])
    assert climb.support[1] != pytest.approx(climb.support[0])


def test_band_is_drawn_where_the_interval_is() -> None:
    view = View((0.0, 0.0), (1.0, 0.5), 10.0, 110.0, 200.0)
    canvas = SvgCanvas(220, 120, "band")
    picture.paint_band(canvas, view, np.array([0.25, 1.75]), "#000000", 1.0)
    picture.paint_band(canvas, view, np.array([np.nan, np.nan]), "#000000", 1.0)
    (polygon,) = ElementTree.fromstring(canvas.document()).iter(SVG + "polygon")
    assert polygon.get("points") == "60,110 210,110 210,10 60,10"


def test_two_robots_share_the_pictures(pair: Scene, tmp_path: Path) -> None:
    shown = titles(document_of(draw.climb_picture(pair)))
    assert "second: move 1 of 1: right front, hold 0 to 4, at 0.70 s" in shown
    assert "end, at 1.50 s" in shown
    draw.draw_page(pair, tmp_path / "climb.html")
    paths = {track["path"] for track in animation_of((tmp_path / "climb.html").read_text())["animations"]}
    assert {"/climb/robots/quadruped/pelvis", "/climb/robots/second/pelvis"} <= paths


# --- any instant ------------------------------------------------------------------------------------------------------


def test_replay_passes_through_the_samples_and_rests_outside_of_the_climb(scene: Scene) -> None:
    climb = scene.climbs[0]
    phase = climb.plan.phases[1]
    moment = climb.at(float(phase.time[7]))
    assert moment.phase == 1
    assert moment.q == pytest.approx(phase.q[7], abs=1e-12)
    middle = climb.at(float(phase.time[7:9].mean()))
    assert middle.q == pytest.approx(phase.q[7:9].mean(axis=0), abs=1e-12)
    assert middle.forces["left_rear"][1] == pytest.approx(phase.force["left_rear"][7:9].mean(axis=0), abs=1e-12)
    assert "right_front" not in middle.forces
    assert climb.at(-5.0).q == pytest.approx(climb.plan.phases[0].q[0])
    assert climb.at(99.0).q == pytest.approx(climb.plan.phases[-1].q[-1])


def test_replay_takes_the_columns_by_name(scene: Scene) -> None:
    climb = scene.climbs[0]
    order = np.random.default_rng(3).permutation(len(climb.plan.positions))
    shuffled = replace(
        climb.plan,
        positions=tuple(climb.plan.positions[i] for i in order),
        phases=tuple(replace(phase, q=phase.q[:, order]) for phase in climb.plan.phases),
    )
    assert Replay(scene.wall, shuffled, climb.robot).at(0.5).q == pytest.approx(climb.at(0.5).q)


def test_plan_of_another_robot_or_wall_is_refused(scene: Scene) -> None:
    climb = scene.climbs[0]
    names = ("x", *climb.plan.positions[1:])
    with pytest.raises(PlanFileError, match="'x'"):
        Replay(scene.wall, replace(climb.plan, positions=names), climb.robot)
    with pytest.raises(PlanFileError, match="no hold 3; the holds are 0 to 2"):
        Replay(Wall(scene.wall.holds[:3]), climb.plan, climb.robot)
    with pytest.raises(PlanFileError, match="swings out of the last of 1 stances"):
        Replay(scene.wall, replace(climb.plan, stances=climb.plan.stances[:1]), climb.robot)


# --- the robot --------------------------------------------------------------------------------------------------------


def test_limbs_end_at_the_feet_and_the_pelvis_is_the_hexagon(scene: Scene) -> None:
    climb = scene.climbs[0]
    moment = climb.at(0.6)
    outline = climb.outline(moment)
    context = climb.robot.context()
    climb.robot.plant.SetPositions(context, moment.q)
    assert outline.feet == pytest.approx(climb.robot.foot_positions(context))
    assert outline.center_of_mass == pytest.approx(climb.robot.center_of_mass(context))
    X_WP = climb.robot.pelvis.EvalPoseInWorld(context)
    assert Polygon(outline.pelvis).area == pytest.approx(1.5 * np.sqrt(3.0) * 0.05**2, rel=1e-3)
    assert np.linalg.norm(outline.pelvis - X_WP.translation()[:2], axis=1) == pytest.approx(0.05, abs=1e-5)
    assert climb.looks.limb_colors[0] == "#d9543d"  # as in the URDF


INERTIAL = '<inertial><mass value="0.1"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>'
TRIPOD = """<robot name="tripod">
  <link name="hub">{inertial}</link>
  <joint name="base" type="planar"><parent link="world"/><child link="hub"/><axis xyz="0 0 1"/></joint>
  {limbs}
</robot>"""


def tripod(folder: Path) -> Robot:
    """Three limbs of one, two and three joints without any geometry."""
    parts, feet = [], []
    for limb in range(3):
        parent, angle = "hub", 2.0 * np.pi * limb / 3.0
        place = f'xyz="{0.1 * np.cos(angle)} {0.1 * np.sin(angle)} 0" rpy="0 0 {angle}"'
        for joint in range(limb + 1):
            link = f"link_{limb}_{joint}"
            parts.append(
                f'<link name="{link}">{INERTIAL}</link>'
                f'<joint name="joint_{limb}_{joint}" type="revolute"><parent link="{parent}"/><child link="{link}"/>'
                f'<origin {place}/><axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>'
            )
            parent, place = link, 'xyz="0.1 0 0"'
        parts.append(f'<frame name="foot_{limb}" link="{parent}" xyz="0.1 0 0" rpy="0 0 0"/>')
        feet.append(f"- {{name: limb_{limb}, foot: foot_{limb}}}")
    (folder / "tripod.urdf").write_text(TRIPOD.format(inertial=INERTIAL, limbs="\n".join(parts)))
    (folder / "tripod.yaml").write_text("pelvis: hub\nlimbs:\n" + "\n".join(feet) + "\n")
    return Robot(folder / "tripod.urdf")


def test_any_number_of_limbs_and_joints_is_drawn_even_without_geometry(tmp_path: Path) -> None:
    looks = Silhouette(tripod(tmp_path))
    q = np.zeros(9)
    q[:3] = 0.3, -0.1, np.pi / 2
    outline = looks.at(q)
    assert [len(limb) for limb in outline.limbs] == [2, 3, 4]
    assert outline.limbs[2][-1] == pytest.approx(
        [0.3 + 0.4 * np.cos(np.pi / 2 + 4 * np.pi / 3), -0.1 + 0.4 * np.sin(np.pi / 2 + 4 * np.pi / 3), 0.0]
    )
    assert Polygon(outline.pelvis).area == pytest.approx(0.75 * np.sqrt(3.0) * 0.1**2, rel=1e-3)
    assert looks.limb_colors == LIMB_COLORS[:3]
    canvas = SvgCanvas(400, 400, "tripod")
    picture.paint_robot(canvas, View((0.0, 0.0), (1.0, 1.0), 0.0, 400.0, 400.0), looks, outline, moving=1)
    ElementTree.fromstring(canvas.document())


# --- the animation ----------------------------------------------------------------------------------------------------


def test_animation_has_the_frames_and_the_duration_of_the_reel(scene: Scene, tmp_path: Path) -> None:
    draw.draw_animation(scene, tmp_path / "climb.gif")
    reel = animation.Reel.of(scene)
    with Image.open(tmp_path / "climb.gif") as image:
        durations = []
        for frame in range(image.n_frames):
            image.seek(frame)
            durations.append(image.info["duration"])
        assert image.n_frames == len(reel.times) == 25
        assert image.info["loop"] == 0
    assert durations == [animation.FRAME_TIME] * 24 + [animation.LAST_FRAME_TIME]
    assert reel.times[-1] == pytest.approx(scene.end)
    assert np.diff(reel.times)[:-1] == pytest.approx(reel.speed * animation.FRAME_TIME / 1000.0)


def test_animation_shows_what_was_drawn(scene: Scene, tmp_path: Path) -> None:
    draw.draw_animation(scene, tmp_path / "climb.gif")
    reel = animation.Reel.of(scene)
    animator = animation.Animator(scene, reel.speed)
    with Image.open(tmp_path / "climb.gif") as image:
        for number in (0, 11, 24):
            image.seek(number)
            drawn = np.asarray(animator.frame(reel.times[number]).picture(), dtype=float)
            shown = np.asarray(image.convert("RGB"), dtype=float)
            assert shown.shape == drawn.shape
            assert np.abs(shown - drawn).mean() < 1.0
            assert np.quantile(np.abs(shown - drawn), 0.999) < 32.0


def test_patches_cover_all_that_moves(scene: Scene) -> None:
    animator = animation.Animator(scene, 1.0)
    frame = animator.frame(0.6)
    whole = RasterCanvas(animator._fine.copy(), animation.FINENESS)
    animator.paint_moving(whole, [climb.at(0.6) for climb in scene.climbs])
    clock_free = np.s_[animation.CAPTION :, :]
    assert np.array_equal(np.asarray(frame.picture())[clock_free], np.asarray(whole.picture())[clock_free])


@pytest.mark.parametrize("duration", [0.5, 7.0, 60.0, 3600.0])
def test_long_climbs_are_played_faster_rather_than_in_more_frames(scene: Scene, duration: float) -> None:
    climb = scene.climbs[0]
    stretch = duration / climb.end
    phases = tuple(replace(phase, time=phase.time * stretch) for phase in climb.plan.phases)
    slow = replace(scene, climbs=(Replay(scene.wall, replace(climb.plan, phases=phases), climb.robot),))
    reel = animation.Reel.of(slow)
    assert len(reel.times) <= animation.MOST_FRAMES + 1
    assert reel.speed == 1.0 or len(reel.times) > animation.MOST_FRAMES / 2
    assert reel.times[-1] == pytest.approx(duration)


def test_palette_keeps_the_frequent_colours_and_maps_others_to_the_nearest() -> None:
    flat = np.zeros((20, 20, 3), dtype=np.uint8)
    flat[:, 10:] = (200, 40, 40)
    palette = gif.Palette([Image.fromarray(flat)])
    assert {tuple(color) for color in palette.colors} == {(0, 0, 0), (200, 40, 40)}
    other = np.array([[[180, 60, 20], [20, 30, 20]]], dtype=np.uint8)
    assert [tuple(palette.colors[i]) for i in palette.indices(Image.fromarray(other))[0]] == [(200, 40, 40), (0, 0, 0)]


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 50)), min_size=2, max_size=6), st.floats(0.5, 9.0))
def test_dashes_cover_half_of_a_line(corners: list[tuple[int, int]], length: float) -> None:
    total = float(np.linalg.norm(np.diff(np.array(corners, dtype=float), axis=0), axis=1).sum())
    covered = sum(float(np.linalg.norm(np.diff(piece, axis=0), axis=1).sum()) for piece in dashes(corners, length))
    assert total / 2.0 - 1e-6 <= covered <= total / 2.0 + length / 2.0 + 1e-6


# --- the page ---------------------------------------------------------------------------------------------------------


def unpack(data: bytes) -> Any:
    """Reads as much of MessagePack as Meshcat's animations use."""
    place = 0

    def take(form: str) -> Any:
        nonlocal place
        (value,) = struct.unpack_from(">" + form, data, place)
        place += struct.calcsize(form)
        return value

    def text(length: int) -> str:
        return bytes(take(f"{length}s")).decode()

    def value() -> Any:
        mark = take("B")
        if mark < 0x80:
            return mark
        if mark < 0x90:
            return {value(): value() for _ in range(mark & 0xF)}
        if mark < 0xA0:
            return [value() for _ in range(mark & 0xF)]
        if mark < 0xC0:
            return text(mark & 0x1F)
        simple = {0xC0: None, 0xC2: False, 0xC3: True}
        if mark in simple:
            return simple[mark]
        numbers = {0xCA: "f", 0xCB: "d", 0xCC: "B", 0xCD: "H", 0xCE: "I", 0xCF: "Q", 0xD0: "b", 0xD1: "h", 0xD2: "i"}
        if mark in numbers:
            return take(numbers[mark])
        if mark in (0xD9, 0xDA, 0xDB):
            return text(take({0xD9: "B", 0xDA: "H", 0xDB: "I"}[mark]))
        if mark in (0xDC, 0xDD):
            return [value() for _ in range(take("H" if mark == 0xDC else "I"))]
        assert mark in (0xDE, 0xDF), hex(mark)
        return {value(): value() for _ in range(take("H" if mark == 0xDE else "I"))}

    return value()


def commands(page: str) -> list[bytes]:
    return [base64.b64decode(blob) for blob in re.findall(r'"data:application/octet-binary;base64,([^"]+)"', page)]


def animation_of(page: str) -> dict[str, Any]:
    (command,) = (command for command in commands(page) if b"set_animation" in command[:20])
    result: dict[str, Any] = unpack(command)
    return result


def test_page_replays_the_climb_in_real_time(plan: Plan, scene: Scene, tmp_path: Path) -> None:
    draw.draw_page(plan, tmp_path / "climb.html")
    played = animation_of((tmp_path / "climb.html").read_text())
    tracks = {(track["path"], key["name"]): key for track in played["animations"] for key in track["clip"]["tracks"]}
    assert {track["clip"]["fps"] for track in played["animations"]} == {meshcat_page.FRAMES_PER_SECOND}
    climb = scene.climbs[0]
    frames = round(climb.end * meshcat_page.FRAMES_PER_SECOND)
    pelvis = tracks["/climb/robots/quadruped/pelvis", ".position"]["keys"]
    assert [key["time"] for key in pelvis] == list(range(frames + 1))
    for number in (0, 17, frames):
        moment = climb.at(number / meshcat_page.FRAMES_PER_SECOND)
        assert pelvis[number]["value"] == pytest.approx([*moment.q[:2], 0.0], abs=1e-9)
    center = tracks["/climb/center_of_mass/0", ".position"]["keys"]
    assert center[-1]["value"][:2] == pytest.approx(climb.outline(climb.at(climb.end)).center_of_mass[:2])
    holding = tracks["/climb/support/0/1_1", ".visible"]["keys"]
    assert [(key["time"], key["value"]) for key in holding] == [(0, False), (12, True), (24, False)]


def test_page_stands_on_its_own(scene: Scene) -> None:
    page = meshcat_page.meshcat_page(scene)
    assert f"<title>{scene.title}</title>" in page
    assert "friction cone" in page
    assert not re.findall(r"<(?:script|link|img)[^>]+(?:src|href)=", page)
    shown = b" ".join(commands(page))
    for number in range(len(scene.wall.holds)):
        assert f"/climb/wall/hold_{number}/cone".encode() in shown
    assert all(f"/climb/wall/obstacle_{number}_0".encode() in shown for number in range(len(scene.wall.obstacles)))


@given(st.floats(1.0, 179.0))
def test_wall_is_stood_up_so_that_gravity_points_down(inclination: float) -> None:
    wall = Wall((), inclination_deg=inclination)
    X_GW = meshcat_page.wall_pose(wall, -0.3)
    assert X_GW.rotation().multiply(wall.gravity) == pytest.approx([0.0, 0.0, -9.81], abs=1e-9)
    assert X_GW.multiply(np.array([0.4, -0.3, 0.0]))[2] == pytest.approx(0.0, abs=1e-12)
    assert X_GW.multiply(RigidTransform([1.0, 0.0, 0.0])).translation()[0] == pytest.approx(1.0)


@given(st.floats(5.0, 175.0), st.floats(0.2, 5.0), st.floats(0.2, 5.0))
def test_camera_is_above_the_ground_on_the_climbers_side(inclination: float, width: float, height: float) -> None:
    lower, upper = np.array([-0.1, -0.2]), np.array([-0.1 + width, -0.2 + height])
    X_GW, camera, target = meshcat_page.viewpoint(Wall((), inclination_deg=inclination), lower, upper)
    assert camera[2] > 0.0
    assert X_GW.inverse().multiply(camera)[2] > 0.5 * height
    assert X_GW.inverse().multiply(target) == pytest.approx([*(lower + upper) / 2.0, 0.0])
    edges = [X_GW.multiply(np.array([x, y, 0.0]))[2] for x, y in (lower, upper)]
    assert min(edges) > -1e-9


@pytest.mark.parametrize(
    "outline",
    [
        np.array([[0, 0], [2, 0], [2, 1], [1, 0.2], [0, 1]]),  # not convex
        np.array([[0, 0], [1, 0], [2, 0], [2, 2], [0, 2]]),  # three corners in a line
        picture.wedge(Hold((0, 0, 0), (0, 1, 0), 0.7)),
        np.asarray(circle((0.1, 0.2), 0.3).exterior.coords[:-1]),
    ],
)
def test_prism_is_closed_and_covers_its_outline(outline: np.ndarray) -> None:
    vertices, faces = meshcat_page.prism(outline, -1.0, 2.0)
    a, b, c = (vertices.T[row] for row in faces)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
    polygon = Polygon(outline)
    assert areas.sum() == pytest.approx(2.0 * polygon.area + 3.0 * polygon.length)
    lids = [[p[:, 2] == z for p in (a, b, c)] for z in (-1.0, 2.0)]
    for lid in lids:
        assert areas[np.logical_and.reduce(lid)].sum() == pytest.approx(polygon.area)
    edges = np.sort(np.vstack([faces[[0, 1]].T, faces[[1, 2]].T, faces[[2, 0]].T]), axis=1)
    assert set(np.unique(edges, axis=0, return_counts=True)[1]) == {2}


# --- all of them ------------------------------------------------------------------------------------------------------

WRITERS: dict[str, Callable[[Scene, Path], None]] = {
    "wall.svg": lambda scene, path: draw.draw_wall(scene.scenario, path),
    "climb.svg": draw.draw_climb,
    "climb.gif": draw.draw_animation,
    "climb.html": draw.draw_page,
}


@pytest.mark.parametrize("name", WRITERS)
def test_failed_run_leaves_an_earlier_file_untouched(
    name: str, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / name
    target.write_text("good")

    def fail(self: Path | Image.Image, *args: object, **kwargs: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(Image.Image, "save", fail)
    monkeypatch.setattr(Path, "write_text", fail)
    with pytest.raises(OSError, match="disk full"):
        WRITERS[name](scene, target)
    assert target.read_bytes() == b"good"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_plan_that_does_not_fit_its_scenario_overwrites_nothing(plan: Plan, tmp_path: Path) -> None:
    wrong = replace(plan, robots=(replace(plan.robots[0], positions=("x", *plan.robots[0].positions[1:])),))
    (tmp_path / "climb.svg").write_text("good")
    with pytest.raises(PlanFileError):
        draw.draw_all(wrong, tmp_path)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("climb.svg", "good")]


def test_a_robot_that_is_there_already_is_drawn_too(plan: Plan, tmp_path: Path) -> None:
    robot = plan.robots[0]
    stays = replace(robot, moves=0, stances=robot.stances[:1], phases=robot.phases[:1])
    still = replace(plan, robots=(stays,))
    for path in draw.draw_all(still, tmp_path):
        assert path.stat().st_size > 1000
    panels = [title for title in titles((tmp_path / "climb.svg").read_text()) if re.search(r", at \d", title)]
    assert panels == ["start, at 0.00 s", f"end, at {DURATION:.2f} s"]


def test_the_same_plan_gives_the_same_pictures(plan: Plan, tmp_path: Path) -> None:
    first = draw.draw_all(plan, tmp_path / "a")
    second = draw.draw_all(plan, tmp_path / "b")
    assert [path.name for path in first] == ["wall.svg", "climb.svg", "climb.gif", "climb.html"]
    for one, other in zip(first[:3], second[:3], strict=True):
        assert one.read_bytes() == other.read_bytes()
    # Meshcat gives its objects random identifiers; the motion is the same.
    assert animation_of(first[3].read_text()) == animation_of(second[3].read_text())
