"""verify in space: a climb of a robot with a floating base passes, and one changed number is found by its check."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plans import LIMBS, PHASE, QUADRUPED, edited, failing, plus, retold, step_plan, times, told, with_margins
from plans_space import LEMUR, climb_plan

from climber.exceptions import ModelError, PlanFileError
from climber.plan_file import Plan
from climber.plan_parts import RobotPlan
from climber.resources import resolve_model
from climber.robot import Model, Robot
from climber.verdict import Ledger
from climber.verify import verify
from climber.verify_rules import RULES
from climber.verify_team import TeamChecks


def test_a_climb_in_space_holds() -> None:
    verdict = verify(climb_plan())
    assert verdict.ok, str(verdict)
    clearances = verdict["self clearance"].worst, verdict["obstacle clearance"].worst
    assert all(worst is not None and worst > 0.004 for worst in clearances)


COLUMN = {name: place for place, name in enumerate(climb_plan().robots[0].positions)}
MORE_ROCK = "facets:\n  - corners: {}\n"
CEILING = "[[-1.0, -1.0, 0.07], [-1.0, 1.0, 0.07], [1.0, 1.0, 0.07], [1.0, -1.0, 0.07]]"
BUMP = "[[-0.05, -0.05, 0.125], [0.05, -0.05, 0.125], [0.05, 0.05, 0.125], [-0.05, 0.05, 0.125]]"
EXACTLY = [
    ("goal pelvis", "scenario/text", told("[0.0, 0.03, 0.15]", "[0.0, 0.03, 0.16]")),
    ("waypoints", "scenario/text", told("[-0.02, 0.01]", "[-0.02, 0.02]")),
    ("posture", f"{PHASE}/1/q/0/{COLUMN['pelvis_base_qx']}", plus(1e-8)),
    ("rest", f"{PHASE}/2/v/160/{COLUMN['pelvis_base_qx']}", plus(2e-6)),
    ("velocity", f"{PHASE}/0/q/40/{COLUMN['pelvis_base_qy']}", plus(5e-6)),
    ("velocity, acceleration", f"{PHASE}/0/v/40/{COLUMN['pelvis_base_qz']}", plus(2e-4)),
    ("acceleration, dynamics at samples", f"{PHASE}/0/vd/40/{COLUMN['pelvis_base_qx']}", plus(8e-3)),
    ("patches", f"{PHASE}/0/contacts/0/point/1", plus(5e-6)),
    ("anchors", f"{PHASE}/1/contacts/0/point/0", plus(1e-7)),
    ("contacts", f"{PHASE}/2/contacts/0/point/0", plus(2e-4)),
    # A wall that faces the other way is one that the robot is inside of.
    ("limb order, obstacle clearance", "scenario/text", told("facets:\n", MORE_ROCK.format(CEILING))),
    ("obstacle clearance", "scenario/text", told("facets:\n", MORE_ROCK.format(BUMP))),
    ("obstacle clearance", "scenario/text", told("0.2], radius: 0.05", "0.2], radius: 0.15")),
    ("obstacle clearance", "scenario/text", told("[0.6, 0.0]", "[0.15, 0.0]")),
    ("obstacle clearance", "scenario/text", told("[0.0, -0.5, 0.1]", "[0.0, -0.1, 0.1]")),
    ("dynamics at samples", f"{PHASE}/1/torque/40/2", plus(0.01)),
    ("dynamics at samples", f"{PHASE}/1/force/left_front/40/2", plus(0.01)),
]


@pytest.mark.parametrize(("checks", "path", "value"), EXACTLY)
def test_one_changed_number_is_found_by_the_check_for_it_and_by_no_other(checks: str, path: str, value: object) -> None:
    assert failing(edited(climb_plan(), path, value)) == set(checks.split(", "))


@pytest.mark.parametrize(
    ("checks", "old", "new"),
    [
        ({"friction"}, "max_force: 60.0", "max_force: 24.0"),
        ({"friction", "equilibrium"}, "friction: 0.7", "friction: 0.3"),
    ],
)
def test_forces_that_holds_do_not_give_are_found(checks: set[str], old: str, new: str) -> None:
    """On other holds, of whose margins the plan is right."""
    assert failing(with_margins(retold(climb_plan(), old, new)).to_json()) == checks


def test_a_pin_that_takes_moments_beside_holds_that_take_none_makes_no_margin_less() -> None:
    right_front = "normal: [0.0, 1.0, -0.5]"
    pinned, turned = (
        with_margins(retold(climb_plan(), right_front, f"{right_front}, grip: pin, max_moment: {moment}"))
        for moment in (0.0, 1.0)
    )
    for number, phase in enumerate(turned.robots[0].phases):
        for kind, margin in phase.margins.items():
            assert margin.value >= 0.97 * pinned.robots[0].phases[number].margins[kind].value
    verdict = verify(turned)
    assert verdict.ok, str(verdict)


def test_errors_are_tried_in_the_direction_that_is_named_too() -> None:
    """It is that of the worst case, between the directions all around."""
    push = f"{PHASE}/1/margins/push"
    too_much = Plan.from_json(edited(climb_plan(), f"{push}/value", times(1.15)), "plan")
    elsewhere = Plan.from_json(edited(too_much, f"{push}/direction", lambda way: [-a for a in way]), "plan")
    named, others = (verify(plan)["margins"].worst for plan in (too_much, elsewhere))
    assert named is not None and others is not None
    assert named > 1.2 * others


NUMBERS = st.one_of(
    st.tuples(st.just("q"), st.integers(0, 160), st.integers(0, 17), st.just(0.01)),
    st.tuples(st.just("v"), st.integers(0, 160), st.integers(0, 17), st.just(0.01)),
    st.tuples(st.just("vd"), st.integers(0, 160), st.integers(0, 17), st.just(1.0)),
    st.tuples(st.just("torque"), st.integers(0, 160), st.integers(0, 11), st.just(0.01)),
    st.tuples(st.sampled_from(LIMBS[1:]).map("force/{}".format), st.integers(0, 160), st.integers(0, 2), st.just(0.01)),
    st.tuples(st.just("contacts"), st.integers(0, 2), st.integers(0, 2).map("point/{}".format), st.just(0.02)),
)


@settings(max_examples=8, deadline=None)
@given(phase=st.integers(0, 2), number=NUMBERS, sign=st.sampled_from([-1.0, 1.0]))
def test_no_number_of_a_motion_goes_unchecked(phase: int, number: tuple[str, int, object, float], sign: float) -> None:
    series, row, column, amount = number
    assert failing(edited(climb_plan(), f"{PHASE}/{phase}/{series}/{row}/{column}", plus(sign * amount)))


def test_the_motion_of_a_free_base_is_not_that_of_its_angles_rates() -> None:
    """Rates of roll, pitch and yaw would be the velocities of three joints, but are not those of a floating base."""
    robot = climb_plan().robots[0]
    model = Robot(Model.load(LEMUR))
    phases = tuple(replace(p, v=model.qdot(p.q, p.v)) for p in robot.phases)
    assert {"velocity", "acceleration"} <= failing(
        replace(climb_plan(), robots=(replace(robot, phases=phases),)).to_json()
    )


def beside(plan: RobotPlan, x: float) -> RobotPlan:
    """The same climb, so much to the right [m] and on holds of its own."""
    column = plan.positions.index("pelvis_base_y")  # y of the joint's frame is x of the wall's
    right = np.eye(len(plan.positions))[column] * x
    phases = tuple(
        replace(phase, q=phase.q + right, contacts=tuple(replace(c, hold=c.hold + 100) for c in phase.contacts))
        for phase in plan.phases
    )
    return replace(plan, name="other", phases=phases)


@pytest.mark.parametrize(("x", "found"), [(1.5, set()), (0.3, {"robot clearance"})])
def test_robots_in_space_keep_apart(x: float, found: set[str]) -> None:
    plan, ledger, robot = climb_plan().robots[0], Ledger(RULES), Robot(Model.load(LEMUR))
    TeamChecks([robot, robot], [plan, beside(plan, x)], ledger).check()
    assert {check.name for check in ledger.checks() if not check.ok} == found


def test_a_planar_robot_needs_holds_that_face_along_its_plane() -> None:
    plan = retold(step_plan(), "normal: [-0.1, 1.0]", "normal: [-0.1, 1.0, 0.1]")
    with pytest.raises(PlanFileError, match=r"wall.holds\[0\].normal: given .* a normal with z = 0"):
        verify(plan)


def test_a_pelvis_in_the_plane_with_limbs_that_leave_it_is_refused(tmp_path: Path) -> None:
    """The quadruped with one knee askew."""
    source = resolve_model(QUADRUPED)
    text = source.read_text()
    start = text.index('<joint name="left_rear_knee"')
    knee = text[start : text.index("</joint>", start)]
    path = tmp_path / "askew.urdf"
    path.write_text(text.replace(knee, knee.replace('<axis xyz="0 0 1"/>', '<axis xyz="0 1 0"/>')))
    described = source.with_suffix(".yaml").read_text()
    path.with_suffix(".yaml").write_text(described[: described.index("symmetries:")])
    plan = retold(step_plan(), QUADRUPED, str(path))
    with pytest.raises(ModelError, match="its limbs leave it"):
        verify(replace(plan, robots=(replace(plan.robots[0], model=str(path)),)))
