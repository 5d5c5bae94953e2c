"""Simulation: what feet do on holds, how a robot follows its plan, and what `climber simulate` says of it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from plans import ERRORS, STEP, edited, just_within, step_plan, still_plan, through_straight_plan
from stored import planned

from climber import simulation_model
from climber.cli import main
from climber.exceptions import ClimberError
from climber.least_margins import least_margins
from climber.plan_parts import MARGIN_KINDS
from climber.reference import Reference
from climber.robot import Model, Robot
from climber.scene import Scene
from climber.simulate import TIME_STEP, certified, monte_carlo, simulate
from climber.simulation import Perturbation, Simulation
from climber.simulation_loop import Loop, Setting
from climber.simulation_model import FOOT_RADIUS, Touch, World
from climber.simulation_page import recorded
from climber.simulation_watch import Footing
from climber.wall import Hold, Wall

# A body whose one foot is at its centre, too heavy to turn by what friction does half a millimetre below.
BODY = """\
<robot name="body">
  <link name="body">
    <inertial><mass value="1"/><inertia ixx="10" iyy="10" izz="10" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="base" type="planar"><parent link="world"/><child link="body"/><axis xyz="0 0 1"/></joint>
  <frame name="foot" link="body" xyz="0 0 0" rpy="0 0 0"/>
</robot>
"""
ORIGIN = (0.0, 0.0, 0.0)


def written(folder: Path, urdf: str) -> Model:
    (folder / "body.urdf").write_text(urdf)
    (folder / "body.yaml").write_text("pelvis: body\nlimbs:\n- {name: only, foot: foot}\n")
    return Model.load(folder / "body.urdf")


@pytest.fixture(scope="module")
def body(tmp_path_factory: pytest.TempPathFactory) -> Model:
    return written(tmp_path_factory.mktemp("body"), BODY)


@pytest.fixture(scope="module")
def light(tmp_path_factory: pytest.TempPathFactory) -> Model:
    """A body as light as a robot is at a foot."""
    return written(tmp_path_factory.mktemp("light"), BODY.replace('mass value="1"', 'mass value="0.02"'))


def pushed(
    model: Model,
    hold: Hold,
    force: tuple[float, float],
    seconds: float,
    gravity: bool = True,
    pressed: bool = False,
) -> tuple[World, Footing]:
    """The body on a hold at the origin under a steady force [N], in W, for so long; pressed by it from the start."""
    wall = Wall((hold,), inclination_deg=90.0 if gravity else 0.0)
    robot = Robot(model, wall.gravity)
    touch = Touch(0, 0, 0, ORIGIN)
    world = World(wall, [robot], [touch] if hold.grip == "pin" else [], TIME_STEP)
    world.place([world.pressed(0, -np.array([*force, 0.0])) if pressed else np.zeros(3)])
    world.touch([touch])
    footing = Footing(wall, 0)
    for _ in range(round(seconds / TIME_STEP)):
        world.step([np.array([*force, 0.0])])
        footing.look(*world.foot(0, 0), TIME_STEP)
    return world, footing


def turned(angle: float) -> tuple[float, float, float]:
    return -float(np.sin(angle)), float(np.cos(angle)), 0.0


# --- feet and holds --------------------------------------------------------------------------------------------------


@given(
    friction=st.floats(0.1, 1.5),
    lean=st.floats(-0.5, 0.5),
    side=st.sampled_from([-1.0, 1.0]),
    push=st.floats(2.0, 20.0),
)
@settings(max_examples=15, deadline=None)
def test_a_foot_slips_if_and_only_if_its_force_leaves_the_cone(body, friction, lean, side, push):
    normal = np.array(turned(lean))[:2]
    along = np.array([normal[1], -normal[0]])
    hold = Hold(ORIGIN, turned(lean), friction, half_width=0.02)
    for share, stays in ((0.9, True), (1.1, False)):
        force = -push * normal + side * share * friction * push * along
        _, footing = pushed(body, hold, tuple(force), 0.3, gravity=False)
        # Drake's friction creeps a little where it should stick: 0.1 mm a second.
        assert (footing.slip < 5e-5) == stays
        assert stays or footing.slip > 0.3 * 0.5 * 0.1 * friction * push * 0.3**2


def test_a_foot_creeps_the_less_the_more_points_share_its_load(light, monkeypatch):
    slips = []
    for points in (1, 2, 4):
        monkeypatch.setitem(simulation_model.POINTS, 2, points)
        _, footing = pushed(light, Hold(ORIGIN, (0.0, 1.0, 0.0), 0.6), (4.0, -10.0), 0.3, gravity=False, pressed=True)
        slips.append(footing.slip)
    assert slips[0] < 1e-4
    assert slips[1:] == pytest.approx([slips[0] / 2, slips[0] / 4], rel=0.1)


def test_a_foot_that_starts_pressed_on_its_hold_does_not_slide_before_it_sticks(light):
    hold, force = Hold(ORIGIN, (0.0, 1.0, 0.0), 0.6), (4.0, -10.0)
    worlds = [pushed(light, hold, force, 0.01, gravity=False, pressed=pressed)[0] for pressed in (False, True)]
    late, once = (world.foot(0, 0)[0][0] for world in worlds)
    assert 0.0 < once < 1e-6 < 1e-5 < late


def test_a_foot_pulled_off_its_hold_is_lost(body):
    _, footing = pushed(body, Hold(ORIGIN, (0.0, 1.0, 0.0), 0.6), (0.0, 12.0), 0.1)
    assert footing.lost


def test_a_foot_that_slides_off_the_patch_is_lost(body):
    _, footing = pushed(body, Hold(ORIGIN, (0.0, 1.0, 0.0), 0.2, half_width=0.01), (5.0, 0.0), 0.2)
    assert footing.lost


def test_a_pin_holds_whichever_way_it_is_pulled(body):
    for force in ((0.0, 0.0), (15.0, 0.0), (-3.0, 18.0)):
        _, footing = pushed(body, Hold(ORIGIN, (0.0, 1.0, 0.0), 0.6, grip="pin"), force, 0.2)
        assert footing.slip < 1e-5
        assert not footing.lost


@pytest.mark.parametrize(("adhesion", "lost"), [(12.0, False), (8.0, True)])
def test_a_magnet_carries_what_it_pulls(body, adhesion, lost):
    below = Hold(ORIGIN, (0.0, -1.0, 0.0), 0.6, half_width=0.01, grip="magnet", adhesion=adhesion)
    _, footing = pushed(body, below, (0.0, 0.0), 0.1)
    assert footing.lost == lost


@given(angle=st.floats(-np.pi, np.pi), slide=st.floats(-0.004, 0.004), roll=st.floats(-2.0, 2.0))
@settings(max_examples=20, deadline=None)
def test_slip_is_what_a_foot_slides_and_not_what_it_rolls(angle, slide, roll):
    wall = Wall((Hold(ORIGIN, turned(angle), 0.6, half_width=0.01),))
    along, steps = wall.tangents[0], 200
    pressed = -1e-6 * wall.normals[0]
    footing = Footing(wall, 0)
    for k in range(steps + 1):
        # Rolling by an angle about z takes the centre along by the radius times as much.
        way = slide * along + FOOT_RADIUS * roll * np.cross([0.0, 0.0, 1.0], wall.normals[0])
        footing.look(pressed + way * k / steps, np.array([0.0, 0.0, roll / (steps * TIME_STEP)]), TIME_STEP)
    assert footing.slip == pytest.approx(abs(slide), abs=1e-9)


def test_what_touches_no_hold_falls_through_it(body):
    wall = Wall((Hold(ORIGIN, (0.0, 1.0, 0.0), 0.6),))
    world = World(wall, [Robot(body, wall.gravity)], [], TIME_STEP)
    world.place([np.zeros(3)])
    for _ in range(round(0.1 / TIME_STEP)):
        world.step([np.zeros(3)])
    assert world.foot(0, 0)[0][1] == pytest.approx(-0.5 * 9.81 * 0.1**2, rel=0.02)


# --- a robot and its plan --------------------------------------------------------------------------------------------


@cache
def stepped() -> Simulation:
    return simulate(step_plan())


def test_a_robot_at_rest_stays_where_it_is():
    plan = still_plan(STEP, (0.01, -0.005, 0.05))
    (robot,) = simulate(plan).robots
    assert not robot.fell
    assert robot.slip < 1e-4
    assert robot.pelvis_error < 1e-4


def test_a_step_is_made_without_a_fall_or_a_slip():
    simulation = stepped()
    (robot,) = simulation.robots
    assert simulation.ok
    assert robot.slip < 3e-4
    assert robot.pelvis_error < 3e-4
    assert simulation.planned <= simulation.simulated < 1.3 * simulation.planned
    assert robot.track.phase.max() == 2


def test_torques_stay_within_what_the_motors_can():
    (robot,) = stepped().robots
    assert all(0.0 < robot.torque[joint] <= robot.effort[joint] for joint in robot.effort)


def test_with_too_little_friction_it_falls():
    simulation = simulate(step_plan(), Perturbation(friction_scale=0.001))
    assert simulation.fell
    assert not simulation.ok
    assert "left hold" in simulation.robots[0].fell


def test_a_slip_beyond_the_limit_is_not_ok():
    simulation = stepped()
    assert not replace(simulation, slip_limit=0.5 * simulation.slip).ok
    assert not simulation.fell


def test_the_clock_waits_for_a_robot_that_starts_astray():
    late = simulate(step_plan(), Perturbation(start_error=0.012, seed=3))
    assert not late.fell
    assert late.robots[0].pelvis_error > 0.004
    assert late.simulated > stepped().simulated
    assert late.slip < 1e-4  # it is led to its plan and not torn


@pytest.mark.parametrize("error", [0.002, 0.005])
def test_a_swinging_foot_looks_for_a_hold_that_is_elsewhere(error):
    for seed in range(2):
        simulation = simulate(step_plan(), Perturbation(hold_error=error, seed=seed))
        assert not simulation.fell
        assert simulation.robots[0].track.phase.max() == 2


def test_a_hand_meets_a_displaced_pin_before_it_grips_it():
    loop = Loop(Setting(planned("double_link")), Perturbation(hold_error=0.003), TIME_STEP)
    (watch,) = loop.watches
    for hands in (2, 1):  # both hold, one swings
        while loop.going and len(watch.controller.touches) == hands:
            ((_, before),) = loop.world.state()
            loop.step()
    pins = {limb: loop.world.wall.positions[hold] for limb, (hold, _) in watch.controller.touches.items()}
    gaps = [np.linalg.norm((loop.world.foot(0, limb)[0] - pin)[:2]) for limb, pin in pins.items()]
    loop.step()
    ((_, after),) = loop.world.state()
    assert len(pins) == 2 and max(gaps) < 2e-5
    # [rad/s] in two time steps; 5 were the hand pulled to the pin from where the plan has it.
    assert np.abs(after - before).max() < 0.2


@pytest.mark.parametrize("off", [0.0008, -0.0008])
def test_a_limb_goes_through_straight_though_its_foot_is_not_quite_where_it_is_to_be(off):
    side = math.copysign(1.0, off)
    away = Perturbation(hold_error=abs(off), hold=0, direction=(-0.8 * side, -0.6 * side, 0.0))
    (robot,) = simulate(through_straight_plan(), away).robots
    first, *_, last = robot.track.q[:, robot.positions.index("right_front_knee")]
    assert not robot.fell
    assert robot.slip < 1e-4
    assert first > 0.5 and last < -0.5


def test_a_heavier_robot_is_still_on_its_plan():
    (robot,) = simulate(step_plan(), Perturbation(mass_scale=1.1)).robots
    assert not robot.fell
    assert robot.pelvis_error < 0.002
    assert max(robot.torque.values()) > max(stepped().robots[0].torque.values())


def test_what_damped_joints_take_is_not_taken_for_mass(tmp_path):
    plan = planned("three_limbed")
    named = Path(plan.robots[0].model)
    for suffix in (".urdf", ".yaml"):
        text = Model.load(plan.robots[0].model).path.with_suffix(suffix).read_text()
        (tmp_path / named.with_suffix(suffix).name).write_text(text.replace('damping="0.0"', 'damping="0.1"'))
    model = str(tmp_path / named.name)
    assert 'damping="0.1"' in Path(model).read_text()
    damped = replace(
        plan,
        scenario_text=plan.scenario_text.replace(plan.robots[0].model, model),
        robots=(replace(plan.robots[0], model=model),),
    )
    (robot,) = simulate(damped, Perturbation(mass_scale=1.65)).robots
    assert not robot.fell
    assert robot.slip < 1e-4


@given(name=st.sampled_from(["step", "three_limbed"]), error=st.sampled_from(ERRORS), seed=st.integers(0, 10**6))
@example(name="three_limbed", error="friction", seed=0)
@example(name="three_limbed", error="lighter", seed=0)
@example(name="step", error="worst push", seed=0)
@example(name="step", error="worst center", seed=0)
@example(name="step", error="worst place", seed=0)
@example(name="three_limbed", error="normals", seed=0)
@settings(max_examples=4, deadline=None)
def test_what_the_margins_certify_is_survived(name, error, seed):
    plan = step_plan() if name == "step" else planned(name)
    perturbation = just_within(plan, error, seed)
    assert certified(plan, perturbation)
    simulation = simulate(plan, perturbation)
    assert simulation.ok, (simulation.slip, simulation.robots[0].fell)


def test_holds_are_displaced_and_turned_by_as_much_as_is_said():
    wall = Wall(tuple(Hold((0.1 * k, 0.0, 0.0), turned(0.3 * k), 0.6) for k in range(4)))
    for dimension in (2, 3):
        every = Perturbation(hold_error=0.01, normal_error=0.2, seed=2).wall(wall, dimension)
        moved = np.linalg.norm(every.positions - wall.positions, axis=1)
        tilt = np.arccos((every.normals * wall.normals).sum(axis=1))
        assert (0.0 < moved).all() and (moved <= 0.01).all() and (0.0 < tilt).all() and (tilt <= 0.2).all()
        one = Perturbation(hold_error=0.01, normal_error=0.2, seed=2, hold=1).wall(wall, dimension)
        moved = np.linalg.norm(one.positions - wall.positions, axis=1)
        tilt = np.arccos(np.minimum((one.normals * wall.normals).sum(axis=1), 1.0))
        np.testing.assert_allclose(moved, [0.0, 0.01, 0.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(tilt, [0.0, 0.2, 0.0, 0.0], atol=1e-7)
    told = Perturbation(normal_error=0.2, direction=(0.0, 0.0, 1.0)).wall(wall, 2)
    np.testing.assert_allclose(told.normals, [turned(0.3 * k + 0.2) for k in range(4)], atol=1e-12)
    with pytest.raises(ClimberError, match="hold: given 4; allowed: 0 to 3"):
        Perturbation(hold_error=0.01, hold=4).wall(wall, 2)


def test_a_centre_of_mass_is_off_by_as_much_as_is_said_and_no_heavier(body):
    wall = Wall((Hold(ORIGIN, (0.0, 1.0, 0.0), 0.6),))
    world = World(wall, [Robot(body, wall.gravity)], [], TIME_STEP)
    world.place([np.array([0.1, 0.2, 0.5])])
    before = world.plant.CalcCenterOfMassPositionInWorld(world.context)
    weight = world.weight(0)
    world.displace_center(0, np.array([0.01, 0.02, 0.0]))
    after = world.plant.CalcCenterOfMassPositionInWorld(world.context)
    np.testing.assert_allclose(after - before, [0.01, 0.02, 0.0], atol=1e-12)
    np.testing.assert_allclose(world.weight(0) - weight, [0.0, 0.0, -9.81 * 0.01], atol=1e-3)


def test_margins_certify_one_error_at_a_time():
    plan = step_plan()
    least = least_margins(plan)
    assert certified(plan, Perturbation(friction_scale=1.0 - 0.9 * least["friction"])) is True
    assert certified(plan, Perturbation(mass_scale=1.0 - 1.1 * least["mass"])) is False
    assert certified(plan, Perturbation(start_error=0.001)) is True
    assert certified(plan, Perturbation(push=0.1, mass_scale=1.01)) is None
    assert certified(plan, Perturbation(center_error=0.9 * least["center"])) is True
    assert certified(plan, Perturbation(normal_error=1.1 * least["normal"])) is False
    assert certified(plan, Perturbation(hold_error=0.9 * least["place"], hold=1)) is True
    assert certified(plan, Perturbation(hold_error=0.001)) is None


@given(kind=st.sampled_from(MARGIN_KINDS), size=st.floats(0.001, 0.9))
def test_an_error_is_as_great_as_margins_measure_it(kind, size):
    assert Perturbation.of(kind, size).errors == {kind: pytest.approx(size)}
    assert Perturbation.of("mass", -size) == Perturbation(mass_scale=1.0 - size)
    assert Perturbation.of("friction", size, seed=3) == Perturbation(friction_scale=1.0 - size, seed=3)


def test_forces_go_over_from_phase_to_phase():
    plan = step_plan()
    (part,) = plan.robots
    reference = Reference(part, Robot(part.model))
    forces = [reference.at(0, t).force for t in np.linspace(*part.phases[0].time[[0, -1]], 2000)]
    forces += [reference.at(1, t).force for t in np.linspace(*part.phases[1].time[[0, -1]], 2000)]
    jumps = np.abs(np.diff(forces, axis=0)).max(axis=(1, 2))
    planned = max(abs(part.phases[0].force[limb][-1] - part.phases[1].force[limb][0]).max() for limb in part.limbs[1:])
    assert planned > 0.5  # the plan's own forces jump where the limb lets go
    assert jumps.max() < 0.5 * planned


def test_the_controller_means_to_carry_the_robot():
    (robot,) = stepped().robots
    weight = 2.0 * 9.81
    assert np.median(robot.track.force.sum(axis=1)[:, 1]) == pytest.approx(weight, rel=0.02)


def test_the_same_seed_gives_the_same_and_another_something_else():
    shaken = Perturbation(hold_error=0.002, start_error=0.001, seed=5)
    one, same, other = (
        simulate(still_plan(STEP, (0.01, -0.005, 0.05)), p) for p in (shaken, shaken, replace(shaken, seed=6))
    )
    assert np.array_equal(one.robots[0].track.q, same.robots[0].track.q)
    assert not np.array_equal(one.robots[0].track.q[0], other.robots[0].track.q[0])


def test_runs_do_not_depend_on_the_number_of_processes():
    plan = still_plan(STEP, (0.01, -0.005, 0.05))
    told = [monte_carlo(plan, [Perturbation(start_error=0.001)], 3, processes=number) for number in (1, 2)]
    for one, two in zip(told[0][0].runs, told[1][0].runs, strict=True):
        assert one.perturbation == two.perturbation
        assert np.array_equal(one.robots[0].track.q, two.robots[0].track.q)


def test_a_recording_is_the_plan_as_it_was_done():
    plan = recorded(step_plan(), stepped())
    (part,) = plan.robots
    assert [phase.label for phase in part.phases] == ["shift", "swing right_front", "shift"]
    climb = Scene.of(plan).climbs[0]
    for time in (0.1, 1.1, 2.0):
        planned = Scene.of(step_plan()).climbs[0].at(time).q
        assert climb.at(time).q == pytest.approx(planned, abs=0.05)


# --- the command -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plan") / "plan.json"
    step_plan().save(path)
    return path


def test_the_command_reports_and_records(file, tmp_path, capsys):
    assert main(["simulate", str(file), "--out", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    for words in ("did not fall", "worst slip", "tracking error", "torques", "real time"):
        assert words in told
    page = (tmp_path / "simulation.html").read_text()
    assert "<title>a step, simulated: worst slip" in page


def test_the_command_says_no_when_the_robot_falls(file, capsys):
    assert main(["simulate", str(file), "--friction-scale", "0.001", "--json"]) == 1
    facts = json.loads(capsys.readouterr().out)
    assert not facts["ok"]
    assert facts["runs"][0]["fell"]
    assert facts["runs"][0]["perturbation"]["friction_scale"] == 0.001
    assert set(facts["runs"][0]["robots"][0]["torque"]) == set(step_plan().robots[0].joints)


def test_the_command_counts_who_comes_through(file, capsys):
    scales = ["--friction-scale", "1", "0.001", "--runs", "2", "--processes", "1"]
    assert main(["simulate", str(file), *scales]) == 1
    told = capsys.readouterr().out
    assert "2 of 2" in told
    assert "friction x 0.001" in told
    assert "0 of 2" in told
    assert "certified by the plan" in told
    assert "first fall: seed 0" in told


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--friction-scale", "0"),
        ("--mass-scale", "-1"),
        ("--hold-error", "nan"),
        ("--start-error", "-0.001"),
        ("--push", "-1"),
        ("--center-error", "nan"),
        ("--normal-error", "-1"),
        ("--hold", "-1"),
        ("--slip-limit", "inf"),
        ("--runs", "0"),
        ("--seed", "-1"),
        ("--processes", "0"),
    ],
)
def test_options_out_of_range_are_refused(file, option, value, capsys):
    assert main(["simulate", str(file), f"{option}={value}"]) == 2
    assert f"{option}: given" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("friction_scale", math.nan),
        ("friction_scale", 1e300),
        ("mass_scale", 0.0),
        ("hold_error", -0.001),
        ("start_error", math.inf),
        ("push", math.nan),
        ("seed", -1),
    ],
)
def test_a_world_that_cannot_be_is_refused_before_drake_is_asked_for_it(name, value):
    with pytest.raises(ClimberError, match=f"{name}: given .*; allowed: "):
        Perturbation(**{name: value})


@pytest.mark.parametrize("seed", [0, 1])
def test_a_robot_that_cannot_even_begin_fell_and_is_shown_where_it_was_to(seed, file, tmp_path, capsys):
    """With one seed a foot leaves its hold in the first millisecond, with the other feet do not reach their holds."""
    out = tmp_path / "out"
    assert main(["simulate", str(file), "--hold-error", "0.2", f"--seed={seed}", "--out", str(out)]) == 1
    told = capsys.readouterr().out
    assert "fell: " in told and "0.00 s for a plan of" in told
    assert "fell: " in (out / "simulation.html").read_text()


def test_a_plan_that_does_not_go_with_its_wall_is_refused(tmp_path, capsys):
    earlier = tmp_path / "simulation.html"
    earlier.write_text("earlier")
    path = tmp_path / "plan.json"
    path.write_text(edited(step_plan(), "robots/0/phases/0/contacts/0/hold", 99))
    assert main(["simulate", str(path), "--out", str(tmp_path)]) == 2
    assert "robots[0].phases[0].contacts[0].hold: given 99" in capsys.readouterr().err
    assert earlier.read_text() == "earlier"


def test_a_plan_that_is_missing_is_refused(tmp_path, capsys):
    assert main(["simulate", str(tmp_path / "none.json")]) == 2
    assert "none.json" in capsys.readouterr().err
