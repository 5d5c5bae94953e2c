"""verify: a good plan passes, and one changed number in its file is found by the check that is there for it."""

from __future__ import annotations

import ast
import io
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plans import (
    AT_THE_EDGE,
    LIMBS,
    PHASE,
    QUADRUPED,
    REMOVED,
    Ground,
    edge_plan,
    edited,
    failing,
    length,
    plus,
    retold,
    step_plan,
    still_plan,
    straight_plan,
    times,
    told,
    with_margins,
)
from rich.console import Console

import climber.verdict
from climber.encounter import Pair, Track
from climber.exceptions import ModelError, PlanFileError
from climber.manifold import Body
from climber.plan_file import Plan
from climber.plan_parts import Achieved
from climber.programs.equilibrium import SupportProgram
from climber.resources import resolve_model
from climber.robot import Model, Robot
from climber.scenario import scenario_from_text
from climber.stance import Contact
from climber.verdict import Ledger
from climber.verify import verify
from climber.verify_rules import RULES
from climber.verify_team import TeamChecks


def with_posture() -> Plan:
    """The step with its start posture in the scenario."""
    robot = step_plan().robots[0]
    angles = dict(zip(robot.positions[3:], robot.phases[0].q[0, 3:].tolist(), strict=True))
    posture = ", ".join(f"{name}: {angle!r}" for name, angle in angles.items())
    return retold(step_plan(), "  goal:\n", f"  start_posture: {{{posture}}}\n  goal:\n")


def with_another_knee(text: str) -> str:
    """A change of the scenario's text, to another start angle of one knee."""
    new, count = re.subn(r"left_rear_knee: [^,]+,", "left_rear_knee: -1.3,", text)
    assert count == 1
    return new


def with_avoided() -> Plan:
    """The step with a goal that is a region only, and a hold and a region to avoid."""
    avoid = "  avoid:\n    holds: [5]\n    regions:\n    - circle: {center: [0.0, -0.2], radius: 0.02}\n"
    return retold(retold(step_plan(), "    holds: [1, 2, 3, 4]\n", ""), "  waypoints:\n", avoid + "  waypoints:\n")


def with_a_free_limb_written_down() -> Plan:
    """The step with the force on the swinging limb, zero, in the file."""
    robot = step_plan().robots[0]
    swing = robot.phases[1]
    swing = replace(swing, force=swing.force | {"right_front": np.zeros((len(swing.time), 3))})
    return replace(step_plan(), robots=(replace(robot, phases=(robot.phases[0], swing, robot.phases[2])),))


def with_a_moment_written_down() -> Plan:
    """The step with the moment on a limb that holds on, zero, in the file."""
    robot = step_plan().robots[0]
    swing = robot.phases[1]
    swing = replace(swing, moment={"left_rear": np.zeros(len(swing.time))})
    return replace(step_plan(), robots=(replace(robot, phases=(robot.phases[0], swing, robot.phases[2])),))


def on_a_model(folder: Path, *changes: tuple[str, str]) -> Plan:
    """The step on a copy of the quadruped's model in which patterns were replaced."""
    source = resolve_model(QUADRUPED)
    text = source.read_text()
    for pattern, new in changes:
        text, count = re.subn(pattern, new, text, flags=re.DOTALL)
        assert count >= 1, pattern
    path = folder / "quadruped.urdf"
    path.write_text(text)
    # One changed link is enough to end a symmetry.
    described = source.with_suffix(".yaml").read_text()
    path.with_suffix(".yaml").write_text(described[: described.index("symmetries:")])
    plan = retold(step_plan(), QUADRUPED, str(path))
    return with_margins(replace(plan, robots=(replace(plan.robots[0], model=str(path)),)))


@pytest.mark.parametrize("make", [step_plan, edge_plan, straight_plan, with_posture, with_avoided])
def test_a_good_plan_holds(make: Callable[[], Plan]) -> None:
    verdict = verify(make())
    assert verdict.ok, str(verdict)


def test_a_plan_at_rest_in_other_units_of_the_file_order_still_holds() -> None:
    """The columns may come in any order, since they are named."""
    robot = step_plan().robots[0]
    turn = lambda values: values[:, ::-1]  # noqa: E731
    phases = tuple(replace(p, q=turn(p.q), v=turn(p.v), vd=turn(p.vd), torque=turn(p.torque)) for p in robot.phases)
    names = {name: getattr(robot, name)[::-1] for name in ("positions", "velocities", "joints")}
    assert verify(replace(step_plan(), robots=(replace(robot, phases=phases, **names),))).ok


EXACTLY = [
    ("stances", step_plan, "robots/0/moves", 2),
    ("phases", step_plan, f"{PHASE}/0/stance", 1),
    ("phases", step_plan, f"{PHASE}/1/kind", "shift"),
    ("phases", step_plan, f"{PHASE}/0/limb", "left_front"),
    ("start stance", step_plan, "scenario/text", told("right_front: 0", "right_front: 4")),
    ("start posture", with_posture, "scenario/text", with_another_knee),
    ("goal", step_plan, "scenario/text", told("[1, 2, 3, 4]", "[0, 1, 2, 3]")),
    ("goal pelvis", step_plan, "scenario/text", told("[0.0, 0.02]", "[0.0, 0.03]")),
    ("waypoints", step_plan, "scenario/text", told("[-0.012, 0.004]", "[-0.017, 0.004]")),
    ("avoided", with_avoided, "scenario/text", told("holds: [5]", "holds: [4]")),
    ("limb order", straight_plan, f"{PHASE}/0/contacts/0/point/0", plus(-5e-5)),
    ("sampling", step_plan, f"{PHASE}/0/time/0", plus(-1e-7)),
    ("time", step_plan, f"{PHASE}/1/time/0", plus(1e-6)),
    ("posture", step_plan, f"{PHASE}/1/q/0/3", plus(1e-8)),
    ("rest", step_plan, f"{PHASE}/2/v/80/0", plus(2e-6)),
    ("velocity", step_plan, f"{PHASE}/0/q/40/4", plus(5e-6)),
    ("acceleration", step_plan, f"{PHASE}/0/vd/40/4", plus(8e-3)),
    ("patches", step_plan, f"{PHASE}/0/contacts/0/point/1", plus(5e-6)),
    ("patches", step_plan, f"{PHASE}/0/contacts/0/point/2", plus(5e-6)),
    ("anchors", step_plan, f"{PHASE}/1/contacts/0/point/0", plus(1e-7)),
    ("contacts", step_plan, f"{PHASE}/2/contacts/0/point/0", plus(2e-4)),
    ("obstacle clearance", step_plan, "scenario/text", told("radius: 0.02}", "radius: 0.12}")),
    ("obstacle clearance", step_plan, "scenario/text", told("[0.33, 0.0]", "[-0.1, -0.13]")),
    ("obstacle clearance", with_avoided, "scenario/text", told("[0.0, -0.2]", "[0.0, -0.02]")),
    ("equilibrium", edge_plan, f"{PHASE}/0/contacts/0/point/0", plus(-8e-5)),
    ("friction", step_plan, f"{PHASE}/1/force/left_rear/40/2", plus(5e-6)),
    ("moments", with_a_moment_written_down, f"{PHASE}/1/moment/left_rear/40", 5e-6),
    ("free limbs", with_a_free_limb_written_down, f"{PHASE}/1/force/right_front/40/1", 5e-5),
    ("dynamics at samples", step_plan, f"{PHASE}/1/torque/40/2", plus(0.01)),
    ("objective", step_plan, "robots/0/objective/kind", "time"),
    ("record", step_plan, "robots/0/record/0/1", 0.0),
    ("record", step_plan, "robots/0/record/0/0", 2.0),
    ("record", step_plan, "robots/0/record/0/0", -1.0),
    ("record", step_plan, "robots/0/record", []),
    ("record", step_plan, "robots/0/objective", None),
    ("dynamics at samples", step_plan, f"{PHASE}/1/force/left_front/40/0", plus(0.01)),
    ("margins", edge_plan, f"{PHASE}/0/margins/friction/value", plus(0.01)),
    ("margins", step_plan, f"{PHASE}/1/margins/push/value", times(1.1)),
    ("margins", step_plan, f"{PHASE}/0/margins/mass/value", times(1.1)),
    ("margins", edge_plan, f"{PHASE}/0/margins/center/value", plus(1e-4)),
    ("margins", edge_plan, f"{PHASE}/0/margins/place/value", plus(1e-3)),
    ("margins", edge_plan, f"{PHASE}/0/margins/normal/value", plus(0.01)),
    ("worst instants", step_plan, f"{PHASE}/1/margins/push/value", plus(-0.4)),
    ("worst instants", step_plan, f"{PHASE}/2/margins/push/time", 1.6),
    ("worst instants", step_plan, f"{PHASE}/1/margins/push/time", plus(0.005)),
    ("worst instants", step_plan, f"{PHASE}/1/margins/mass/direction/1", -1.0),
    ("worst instants", step_plan, f"{PHASE}/1/margins/push/direction/1", plus(0.1)),
    ("worst instants", step_plan, f"{PHASE}/1/margins/normal/limb", "left_front"),
    ("worst instants", step_plan, f"{PHASE}/1/margins/normal/value", plus(-0.05)),
    ("worst instants", step_plan, f"{PHASE}/1/margins/place/limb", "right_front"),
    ("worst instants", step_plan, f"{PHASE}/1/margins/push/limb", "left_front"),
    ("worst instants", step_plan, f"{PHASE}/1/margins/place/value", 0.03),
    ("worst instants", step_plan, f"{PHASE}/1/margins/friction/limb", "left_front"),
    ("worst instants", step_plan, f"{PHASE}/1/margins/mass/direction", [0.6, 0.8, 0.0]),
    ("worst instants", step_plan, f"{PHASE}/1/margins/push/direction/2", 1e-5),
    ("worst instants", step_plan, f"{PHASE}/1/margins/normal/direction", [0.0, 0.0, 1.0]),
]


@pytest.mark.parametrize(("check", "make", "path", "value"), EXACTLY)
def test_one_changed_number_is_found_by_the_check_for_it_and_by_no_other(
    check: str, make: Callable[[], Plan], path: str, value: object
) -> None:
    assert failing(edited(make(), path, value)) == {check}


@pytest.mark.parametrize("limit", ["max_force: 6.0", "min_force: 2.5"])
def test_forces_that_holds_do_not_give_are_found(limit: str) -> None:
    """On holds with other limits, of whose margins the plan is right."""
    old = {"max_force: 6.0": "max_force: 20.0", "min_force: 2.5": "min_force: 1.0"}[limit]
    assert failing(with_margins(retold(step_plan(), old, limit)).to_json()) == {"friction"}


@pytest.mark.parametrize(
    ("check", "series", "joint", "phase", "limit", "nudge"),
    [
        ("joint limits", "q", "left_front_knee", 2, r'lower="[^"]*" upper="[^"]*"', 1e-8),
        ("speed limits", "v", "right_front_knee", 1, r'velocity="[^"]*"', 1e-8),
        ("torque limits", "torque", "left_rear_hip", 0, r'effort="[^"]*"', 5e-5),
    ],
)
def test_a_number_just_beyond_what_the_model_allows_is_found(
    tmp_path: Path, check: str, series: str, joint: str, phase: int, limit: str, nudge: float
) -> None:
    """On a model whose limit is just what the plan needs, only the limit's own check sees a little more."""
    robot = step_plan().robots[0]
    column = (robot.joints if series == "torque" else robot.positions).index(joint)
    values = getattr(robot.phases[phase], series)[:, column]
    row = int(np.argmax(np.abs(values)))
    most = abs(float(values[row]))
    new = limit.replace('"[^"]*"', f'"{most!r}"').replace(f'lower="{most!r}"', f'lower="{-most!r}"')
    plan = on_a_model(tmp_path, (f'(<joint name="{joint}" type="revolute">.*?){limit}', rf"\g<1>{new}"))
    assert verify(plan).ok
    beyond = plus(float(np.copysign(nudge, values[row])))
    assert failing(edited(plan, f"{PHASE}/{phase}/{series}/{row}/{column}", beyond)) == {check}


def test_links_that_touch_are_found_on_a_fatter_model(tmp_path: Path) -> None:
    fat = r'(<collision name="(?:left|right)_rear_thigh_link">.*?capsule radius=)"0.006"'
    assert failing(on_a_model(tmp_path, (fat, r'\1"0.045"')).to_json()) == {"self clearance"}


def test_what_drake_knows_of_a_model_and_verify_does_not_is_noticed(tmp_path: Path) -> None:
    """A bushing in a knee is beyond verify's own mechanics, so it says that these are not Drake's."""
    bushing = """<drake:linear_bushing_rpy>
      <drake:bushing_frameA name="left_rear_foot"/><drake:bushing_frameC name="right_rear_foot"/>
      <drake:bushing_torque_stiffness value="0 0 0"/><drake:bushing_torque_damping value="0 0 0"/>
      <drake:bushing_force_stiffness value="1 1 1"/><drake:bushing_force_damping value="0 0 0"/>
    </drake:linear_bushing_rpy></robot>"""
    assert failing(on_a_model(tmp_path, ("</robot>", bushing)).to_json()) == {"mechanics"}


# Where one wrong number is bound to be seen by several checks, the one for it must be among them.
SEVERAL = [
    # A wrong angle moves links and feet, and no velocity leads to it.
    ("self clearance", {"contacts", "velocity", "dynamics at samples", "dynamics between"}, "q", 5, 2.0),
    ("joint limits", {"contacts", "velocity", "dynamics at samples", "dynamics between"}, "q", 6, 5.0),
    ("speed limits", {"velocity", "acceleration", "dynamics at samples"}, "v", 6, 5.0),
    # A torque that is far off is off between the samples too.
    ("torque limits", {"dynamics at samples", "dynamics between"}, "torque", 2, 5.0),
]


@pytest.mark.parametrize(("check", "others", "series", "column", "amount"), SEVERAL)
def test_a_gross_error_is_found_by_its_check_and_by_those_it_is_bound_to_trip(
    check: str, others: set[str], series: str, column: int, amount: float
) -> None:
    found = failing(edited(step_plan(), f"{PHASE}/1/{series}/40/{column}", plus(amount)))
    assert {check} | others <= found


def test_a_wrong_list_entry_is_found() -> None:
    """Another hold in a stance contradicts the contacts, wherever else it shows."""
    found = failing(edited(step_plan(), "robots/0/stances/1/right_front", 5))
    assert found == {"phases", "goal"}
    assert "stances" in failing(edited(step_plan(), "robots/0/stances/1/right_front", 2))
    assert "stances" in failing(edited(step_plan(), "robots/0/stances/0/left_rear", 5))
    assert "phases" in failing(edited(step_plan(), f"{PHASE}/2", REMOVED))
    assert "phases" in failing(edited(step_plan(), f"{PHASE}/0/contacts/3", REMOVED))


NUMBERS = st.one_of(
    st.tuples(st.just("q"), st.integers(0, 80), st.integers(0, 10), st.just(0.01)),
    st.tuples(st.just("v"), st.integers(0, 80), st.integers(0, 10), st.just(0.01)),
    st.tuples(st.just("vd"), st.integers(0, 80), st.integers(0, 10), st.just(1.0)),
    st.tuples(st.just("torque"), st.integers(0, 80), st.integers(0, 7), st.just(0.01)),
    st.tuples(st.sampled_from(LIMBS).map("force/{}".format), st.integers(0, 80), st.integers(0, 2), st.just(0.01)),
    st.tuples(st.just("contacts"), st.integers(0, 2), st.integers(0, 2).map("point/{}".format), st.just(0.02)),
)


@settings(max_examples=40, deadline=None)
@given(phase=st.integers(0, 2), number=NUMBERS, sign=st.sampled_from([-1.0, 1.0]))
def test_no_number_of_a_motion_goes_unchecked(phase: int, number: tuple[str, int, object, float], sign: float) -> None:
    series, row, column, amount = number
    plan = with_a_free_limb_written_down()
    assert failing(edited(plan, f"{PHASE}/{phase}/{series}/{row}/{column}", plus(sign * amount)))


def test_every_check_is_tripped_by_a_test_here() -> None:
    tripped = {case[0] for case in EXACTLY} | {case[0] for case in SEVERAL} | SEVERAL[0][1]
    own = {"mechanics", "clock", "holds of one", "robot clearance", "asked margins"}  # these have tests of their own
    own |= {name for name in RULES if name.split()[0] in ("timing", "active")}
    assert set(RULES) - tripped == own


@pytest.mark.parametrize("kind", ["length", "time", "margin"])
def test_a_value_that_is_not_that_of_the_phases_is_found(kind: str) -> None:
    """Also one that is a little better, with the record gone along."""
    value = {"length": length(step_plan().robots[0].phases), "time": 2.4, "margin": -margin()}[kind]
    robot = replace(step_plan().robots[0], objective=Achieved(kind, value), record=((1.0, value),))
    assert verify(replace(step_plan(), robots=(robot,))).ok
    better = replace(robot, objective=Achieved(kind, value - 2e-5), record=((1.0, value - 2e-5),))
    assert failing(replace(step_plan(), robots=(better,)).to_json()) == {"objective"}


def margin() -> float:
    """The least slack of the step, by the planner's own forces and Drake's centre of mass."""
    robot, wall = Robot(Model.load(QUADRUPED)), scenario_from_text(step_plan().scenario_text).build_wall()
    context, slack = robot.context(), [1.0]
    phases = step_plan().robots[0].phases
    supports = []
    for phase in phases:
        contacts = [Contact(robot.limb_names.index(contact.limb), contact.hold) for contact in phase.contacts]
        offsets = [float((c.point - wall.positions[c.hold]) @ wall.tangents[c.hold]) for c in phase.contacts]
        contacts = [replace(contact, offset=offset) for contact, offset in zip(contacts, offsets, strict=True)]
        supports.append(SupportProgram.of_contacts(wall, contacts, robot.mass))
    for number, phase in enumerate(phases):
        slack.append(float((1 - np.abs(phase.torque) / robot.effort).min()))
        for row, q in enumerate(phase.q):
            robot.plant.SetPositions(context, q)
            x = float(robot.plant.CalcCenterOfMassPositionInWorld(context)[0])
            ends = {0: number - 1, len(phase.q) - 1: number + 1}
            over = [supports[k] for k in {number, ends.get(row, number)} if 0 <= k < len(phases)]
            slack += [support.margin(x) / float(robot.reach.mean()) for support in over]
    return min(slack)


def test_samples_that_are_too_far_apart_are_found() -> None:
    robot = step_plan().robots[0]
    series = ("time", "q", "v", "vd", "torque")
    phases = []
    for phase in robot.phases:
        thinned = {name: getattr(phase, name)[::2] for name in series}
        phases.append(replace(phase, **thinned, force={limb: force[::2] for limb, force in phase.force.items()}))
    verdict = verify(with_margins(replace(step_plan(), robots=(replace(robot, phases=tuple(phases)),))))
    assert [check.name for check in verdict.failures] == ["sampling"]
    assert verdict["sampling"].worst == pytest.approx(0.02)


def test_acceleration_that_is_not_the_derivative_of_velocity_is_found_however_small_the_forces_are() -> None:
    """The motion of a plan played half as fast, with the accelerations left as they were."""
    robot = step_plan().robots[0]
    phases = tuple(replace(phase, vd=phase.vd * 0.25) for phase in robot.phases)
    assert "acceleration" in failing(replace(step_plan(), robots=(replace(robot, phases=phases),)).to_json())


def test_a_stance_that_cannot_be_held_has_no_margin_to_report() -> None:
    verdict = verify(retold(step_plan(), "max_force: 20.0", "max_force: 2.0"))
    assert not verdict["equilibrium"].ok
    assert verdict["equilibrium"].worst is None
    assert "empty (infeasible)" in verdict["equilibrium"].where
    assert "friction" in {check.name for check in verdict.failures}
    assert json.loads(verdict.to_json())["ok"] is False


def test_a_goal_by_limb_is_checked_limb_by_limb() -> None:
    by_limb = "    stance: {right_front: 4, left_front: 1, left_rear: 2, right_rear: 3}\n"
    good = retold(step_plan(), "    holds: [1, 2, 3, 4]\n", by_limb)
    assert verify(good).ok
    assert failing(
        retold(good, "left_rear: 2, right_rear: 3}\n    p", "left_rear: 3, right_rear: 2}\n    p").to_json()
    ) == {"goal"}


def test_waypoints_must_come_in_their_order_if_one_is_given() -> None:
    first = "  - {name: before the swing, pelvis: {circle: {center: [-0.012, 0.004], radius: 0.001}}}\n"
    second = "  - {name: at the end, holds: [1, 2, 3, 4]}\n"
    assert verify(retold(step_plan(), first, first + second)).ok
    assert verify(retold(step_plan(), first, second + first)).ok
    given = "  waypoint_order: given\n  waypoints:\n"
    in_order = retold(step_plan(), "  waypoints:\n", given)
    assert verify(retold(in_order, first, first + second)).ok
    assert failing(retold(in_order, first, second + first).to_json()) == {"waypoints"}


def two_standing(apart: float, late: float = 0.0) -> Plan:
    """Two robots that stand still side by side.

    Args:
        apart: How far the second is to the right of the first [m].
        late: How much later than the first it begins [s].
    """
    aside = np.array([apart, 0.0, 0.0])
    positions = np.vstack([AT_THE_EDGE.positions, AT_THE_EDGE.positions + aside[:2]])
    one = still_plan(Ground(positions, np.array([[0.0, 1.0]] * 8)), (0.0, 0.01, 0.05))
    one = retold(one, "  - polygon: {vertices: [[0.26, -0.1], [0.40, -0.1], [0.40, 0.1], [0.33, 0.0]]}\n", "")
    first, phase = one.robots[0], one.robots[0].phases[0]
    contacts = tuple(replace(c, hold=c.hold + 4, point=c.point + aside) for c in phase.contacts)
    phase = replace(phase, contacts=contacts, q=phase.q + apart * np.eye(11)[0], time=phase.time + late)
    stance = {limb: hold + 4 for limb, hold in first.stances[0].items()}
    second = replace(first, name="other", stances=(stance,), phases=(phase,))
    spec = f"""\
- name: other
  model: {QUADRUPED}
  start: {{right_front: 4, left_front: 5, left_rear: 6, right_rear: 7}}
  goal: {{pelvis: {{circle: {{center: [{apart}, 0.0], radius: 0.2}}}}}}
"""
    return replace(one, scenario_text=one.scenario_text + spec, robots=(first, second))


def test_two_robots_side_by_side_hold_and_their_distance_is_told() -> None:
    verdict = verify(two_standing(1.0))
    assert verdict.ok, str(verdict)
    check = verdict["robot clearance"]
    # The planner measures in another way.
    plan = two_standing(1.0)
    robot = Robot(Model.load(QUADRUPED))
    body = Body(robot, scenario_from_text(plan.scenario_text, "text").build_wall())
    one, two = (Track.standing(robot_plan.phases[0].q[0]) for robot_plan in plan.robots)
    assert check.worst == pytest.approx(Pair(body, body).nearest(one, two, 0.0).distance, abs=1e-9)
    assert re.match(r"quadruped, right_\w+ and other, left_\w+, t = \d\.\d{4} s", check.where)


@pytest.mark.parametrize("step", [1e-4, -1e-4])
def test_robots_that_touch_by_a_tenth_of_a_millimetre_are_found(step: float) -> None:
    """Moved together until they touch, and that much farther or less far."""
    worst = verify(two_standing(1.0))["robot clearance"].worst
    assert worst is not None
    near = 1.0 - worst
    for _ in range(40):  # not along the line between the nearest points, so that it takes a few steps
        worst = verify(two_standing(near))["robot clearance"].worst
        assert worst is not None
        if abs(worst) < 1e-9:
            break
        near -= worst
    assert failing(two_standing(near + step).to_json()) == (set() if step > 0 else {"robot clearance"})


def test_robots_on_clocks_of_their_own_are_found() -> None:
    assert failing(two_standing(1.0, late=1e-6).to_json()) == {"clock"}
    verdict = verify(two_standing(1.0, late=1e-6))
    assert verdict["clock"].worst == pytest.approx(1e-6)
    longer = edited(two_standing(1.0), "robots/0/phases/0/time/2", plus(1e-7))
    assert failing(longer) == {"clock", "sampling"}


def meeting(holds: dict[int, int], late: float) -> set[str]:
    """Team checks failed by two robots that step at once, 2 m apart.

    Args:
        holds: The second's holds that are numbered otherwise than the first's plus 10.
        late: How much later the second is [s].
    """
    first = step_plan().robots[0]
    phases = []
    for phase in first.phases:
        contacts = tuple(replace(c, hold=holds.get(c.hold, c.hold + 10)) for c in phase.contacts)
        phases.append(replace(phase, contacts=contacts, q=phase.q + 2.0 * np.eye(11)[0], time=phase.time + late))
    second = replace(first, name="other", phases=tuple(phases))
    ledger = Ledger(RULES)
    robot = Robot(Model.load(QUADRUPED))
    TeamChecks([robot, robot], [first, second], ledger).check()
    return {check.name for check in ledger.checks() if not check.ok}


def test_a_hold_may_be_passed_on_but_never_shared() -> None:
    """The first is on hold 0 until 0.8 s and on 4 from 1.6 s on; the second's right front foot does likewise."""
    assert meeting({}, 0.0) == set()
    assert meeting({4: 0}, 0.0) == set()  # taken 0.8 s after it was left
    assert meeting({0: 4}, 0.0) == set()
    assert meeting({0: 4}, 0.79) == {"clock"}
    assert meeting({0: 4}, 0.81) == {"clock", "holds of one"}
    assert meeting({1: 1}, 0.0) == {"holds of one"}


def test_a_hold_that_is_taken_at_the_very_instant_at_which_it_is_left_is_shared() -> None:
    end = step_plan().robots[0].phases[1].time[-1] - step_plan().robots[0].phases[0].time[-1]
    assert meeting({0: 4}, float(end)) == {"clock", "holds of one"}


def test_the_verdict_says_where() -> None:
    verdict = verify(Plan.from_json(edited(step_plan(), f"{PHASE}/1/torque/40/2", plus(0.01))))
    check = verdict["dynamics at samples"]
    assert check.worst == pytest.approx(0.01, rel=1e-3)
    assert check.where == "quadruped, phase 1 (swing right_front), t = 1.2000 s, left_front_hip"
    assert (check.limit, check.sense, check.unit) == (1e-4, "at most", "N, N m")
    near = verify(retold(step_plan(), "radius: 0.02}", "radius: 0.12}"))["obstacle clearance"]
    assert near.worst is not None and near.worst < -0.01
    assert "obstacle 0" in near.where and "phase" in near.where


def test_the_verdict_reads_as_a_table_and_as_json() -> None:
    verdict = verify(step_plan())
    table = str(verdict)
    data = json.loads(verdict.to_json())
    assert data["ok"] is True and data["plan"] == "plan"
    for check in data["checks"]:
        assert check["name"] in table and check["ok"] is True
    with pytest.raises(KeyError):
        verdict["no such check"]


def test_a_verdict_fits_a_terminal_of_eighty_columns() -> None:
    verdict = verify(step_plan())
    console = Console(file=io.StringIO(), width=80)
    console.print(verdict)
    file = console.file
    assert isinstance(file, io.StringIO)
    lines = file.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    assert all(
        sum(line.startswith(("ok", "FAIL")) and check.name in line for line in lines) for check in verdict.checks
    )
    words = " ".join(file.getvalue().split())
    assert all(" ".join(check.where.split()) in words for check in verdict.checks)


def test_a_plan_and_its_file_get_the_same_verdict(tmp_path: Path) -> None:
    step_plan().save(tmp_path / "plan.json")
    assert verify(tmp_path / "plan.json").checks == verify(step_plan()).checks
    assert verify(str(tmp_path / "plan.json")).source == str(tmp_path / "plan.json")


def test_verdicts_do_not_depend_on_the_working_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert verify(step_plan()).ok


@pytest.mark.parametrize(
    ("path", "value", "complaint"),
    [
        ("scenario/text", "", r"scenario\.text"),
        ("scenario/text", "wall: [", r"scenario\.text"),
        ("scenario/text", told("normal: [-0.1, 1.0]", "normal: [0.0, 0.0]"), r"wall\.holds\[0\]\.normal"),
        ("scenario/text", told("right_rear: 3}", "tail: 3}"), "tail"),
        ("scenario/text", told(QUADRUPED, "nowhere.urdf"), r"nowhere\.urdf"),
        ("robots/0/name", "spider", r"robots: the scenario's robots are expected: quadruped"),
        ("robots/0/model", "package://climber/other.urdf", r"robots\[0\]\.model: the scenario says"),
        ("robots/0/limbs", ["left_front", "right_front", "left_rear", "right_rear"], r"limbs: the model has .* order"),
        ("robots/0/positions/0", "x", r"positions: the model has base_x"),
        ("robots/0/velocities/3", "hip", r"velocities: the model has"),
        ("robots/0/joints/3", "hip", r"joints: the model has"),
        ("robots/0/stances/1/left_rear", 6, r"stances\[1\]\.left_rear: the wall has 6 holds"),
        (f"{PHASE}/2/contacts/1/hold", 17, r"phases\[2\]\.contacts\[1\]\.hold: the wall has 6 holds"),
    ],
)
def test_a_file_that_cannot_be_understood_is_an_error_and_not_a_verdict(
    path: str, value: object, complaint: str
) -> None:
    with pytest.raises(PlanFileError, match=complaint):
        verify(Plan.from_json(edited(step_plan(), path, value)))


def test_a_model_that_drake_cannot_read_is_a_model_error(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="quadruped"):
        verify(on_a_model(tmp_path, ("<link", "<lnk")))


def test_verify_uses_nothing_of_the_planner() -> None:
    """Whoever checks a plan must not share the mistakes of whoever made it: what verify imports, and what that does."""
    folder = Path(climber.verdict.__file__).parent
    reached, waiting = set(), ["verify"]
    while waiting:
        name = waiting.pop()
        reached.add(name)
        tree = ast.parse((folder / f"{name}.py").read_text())
        for_types = [
            node for node in tree.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        ]
        skipped = {id(child) for node in for_types for child in ast.walk(node)}  # never run
        for node in ast.walk(tree):
            if id(node) in skipped:
                continue
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("climber"):
                module = str(node.module).removeprefix("climber").removeprefix(".").replace(".", "/")
                assert module, f"{name} imports from the package itself"
                waiting += [module] if module not in reached else []
            elif isinstance(node, ast.Import):
                assert not any(alias.name.startswith("climber") for alias in node.names)
    own = {path.stem for path in folder.glob("verify*.py")} | {"verdict"}
    given = {"plan_file", "plan_parts", "plan_reader", "plan_json", "files", "exceptions", "resources", "stance"}
    given |= {"wall", "robot", "limb", "model", "symmetry", "floating", "solids", "polyhedron"}
    assert own <= reached
    assert {name.split("_")[0] for name in reached - own - given} <= {"scenario", "yaml"}
