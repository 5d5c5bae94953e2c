"""verify: what a plan says of its timing is true, and each untruth is found by the check that is there for it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from plans import edited, step_plan
from test_verify import PHASE, failing

from climber.exceptions import PlanFileError
from climber.plan_file import Plan
from climber.plan_parts import Phase, PhaseTiming
from climber.verify import verify

MASS = 2.0  # [kg] of the quadruped


@cache
def told() -> Plan:
    """The step, its swing with limits that it reaches in the right front hip, and claims about where it does."""
    plan = step_plan()
    (robot,) = plan.robots
    swing = robot.phases[1]
    column = robot.velocities.index("right_front_hip")
    v, vd = np.abs(swing.v[:, column]), np.abs(swing.vd[:, column])
    jerk = np.abs(np.diff(swing.vd[:, column])) / np.diff(swing.time)
    limits = {
        kind: {"right_front_hip": float(most)}
        for kind, most in (("speed", v.max()), ("acceleration", vd.max()), ("jerk", jerk.max()))
    }
    active = [(*_around(swing, int(rates.argmax())), f"{kind} right_front_hip") for kind, rates in _rates(v, vd, jerk)]
    timing = PhaseTiming("conic", limits, tuple(sorted(active)))
    phases = (robot.phases[0], replace(swing, timing=timing), robot.phases[2])
    return replace(plan, robots=(replace(robot, phases=phases),))


def _rates(v: np.ndarray, vd: np.ndarray, jerk: np.ndarray) -> list[tuple[str, np.ndarray]]:
    return [("speed", v), ("acceleration", vd), ("jerk", jerk)]


def _around(phase: Phase, place: int) -> tuple[float, float]:
    """The time at a sample and at a neighbour of it."""
    first = min(place, len(phase.time) - 2)
    return float(phase.time[first]), float(phase.time[first + 1])


def with_claim(name: str, begin: float, end: float) -> str:
    """The step with one claim more, the others as they are."""
    plan = told()
    (robot,) = plan.robots
    swing = robot.phases[1]
    active = tuple(sorted((*swing.timing.active, (begin, end, name))))
    swing = replace(swing, timing=replace(swing.timing, active=active))
    phases = (robot.phases[0], swing, robot.phases[2])
    return replace(plan, robots=(replace(robot, phases=phases),)).to_json()


def test_true_claims_hold() -> None:
    verdict = verify(told())
    assert verdict.ok
    assert verdict["timing limits"].worst == pytest.approx(1.0)
    assert verdict["timing jerk"].worst == pytest.approx(1.0)
    assert 0.9 < (verdict["active limits"].worst or 0.0) <= 1.0


@pytest.mark.parametrize(
    ("check", "path", "value"),
    [
        ("timing limits", "limits/speed/right_front_hip", lambda limit: limit / 1.2),
        ("timing limits", "limits/acceleration/right_front_hip", lambda limit: limit / 1.2),
        ("timing jerk", "limits/jerk/right_front_hip", lambda limit: limit / 1.6),
        ("timing", "limits/speed/right_front_hip", lambda limit: -limit),
        ("timing", "limits/speed/right_front_hip", 0.0),
        ("timing", "limits/jerk/right_front_hip", lambda limit: -limit),  # of jerk the model has no limit
        ("timing", "method", "paced"),
        ("timing", "active/0/2", "speed left_front_hip"),  # it has no limit of its own
        ("timing", "active/0/2", "torque of right_front_hip"),
        ("timing", "active/0/2", "friction right_front"),  # that limb swings
        ("timing", "active/0/2", "moment left_front"),  # on no pin
        ("timing", "active/0/0", 0.5),  # before the phase
        ("timing", "active/2/1", 3.0),
        ("timing", "active/1", [1.5, 1.5, "speed right_front_hip"]),
    ],
)
def test_an_untruth_is_found_by_the_check_for_it(check: str, path: str, value: object) -> None:
    assert check in failing(edited(told(), f"{PHASE}/1/timing/{path}", value))


def test_of_two_timings_one_of_which_was_slowed_the_greater_limits_are_told() -> None:
    at_full = PhaseTiming("conic", {"speed": {"hip": 3.6, "knee": 3.6}}, ((0.0, 0.1, "speed hip"),))
    slowed = PhaseTiming(
        "conic", {"speed": {"hip": 1.8, "knee": 3.6}}, ((0.0, 0.1, "friction left"), (0.1, 0.2, "speed hip"))
    )
    knee = replace(slowed, active=((0.2, 0.3, "speed knee"),))
    both = at_full.followed(1.0, slowed).followed(2.0, knee)
    assert both.limits == at_full.limits
    told = [(0.0, 0.1, "speed hip"), (1.0, 1.1, "friction left"), (2.2, 2.3, "speed knee")]
    assert [interval[2] for interval in both.active] == [interval[2] for interval in told]
    assert np.array([interval[:2] for interval in both.active]) == pytest.approx(np.array([each[:2] for each in told]))
    # And of one by a law of fixed shape nothing is, nor of any other that it is one with.
    assert at_full.followed(1.0, PhaseTiming()) == PhaseTiming().followed(1.0, at_full) == PhaseTiming()


def test_a_limit_of_jerk_beyond_the_scenarios_is_found_of_joints_and_of_the_pelvis() -> None:
    (robot,) = told().robots
    jerk = robot.phases[1].timing.limits["jerk"]["right_front_hip"]
    text = told().scenario_text + f"budget: {{jerk_limit: {jerk}}}\n"
    asked = Plan.from_json(edited(told(), "scenario/text", text))
    assert verify(asked).ok
    limits = f"{PHASE}/1/timing/limits/jerk"
    for name, most in (("right_front_hip", jerk), ("base_wz", jerk), ("base_vx", 0.25 * jerk)):
        told_so = edited(asked, limits, {"right_front_hip": jerk, name: 1.01 * most})
        assert "timing" in failing(told_so)
        assert "timing" not in failing(edited(asked, limits, {"right_front_hip": jerk, name: 0.99 * most}))


def test_a_limit_beyond_the_models_is_found() -> None:
    for kind in ("speed", "acceleration"):
        path = f"{PHASE}/1/timing/limits/{kind}/right_front_hip"
        assert "timing" in failing(edited(told(), path, {"speed": 4.1, "acceleration": 61.0}[kind]))


@pytest.mark.parametrize("kind", ["speed", "acceleration", "jerk", "torque"])
def test_a_limit_told_as_active_where_it_is_far_away_is_found(kind: str) -> None:
    (robot,) = told().robots
    swing = robot.phases[1]
    column = robot.velocities.index("right_front_hip")
    use = {
        "speed": np.abs(swing.v[:, column]),
        "acceleration": np.abs(swing.vd[:, column]),
        "jerk": np.abs(np.gradient(swing.vd[:, column])),
        "torque": np.abs(swing.torque[:, robot.joints.index("right_front_hip")]),
    }[kind]
    inner = 5 + int(use[5:-5].argmin())
    assert failing(with_claim(f"{kind} right_front_hip", *_around(swing, inner))) == {"active limits"}


@pytest.mark.parametrize("kind", ["friction", "force limit"])
def test_a_contact_told_to_be_at_its_limit_is_so_or_is_found(kind: str) -> None:
    """The holds press along their cone's edges with 1 to 20 N; forces and cone are worked out here from the angle."""
    (robot,) = told().robots
    swing = robot.phases[1]
    (contact,) = (c for c in swing.contacts if c.limb == "left_rear")
    force = swing.force["left_rear"]
    normal = np.array([0.1, 1.0, 0.0]) / np.hypot(0.1, 1.0)
    angle = np.arctan(0.6)
    along, aside = force @ normal, np.linalg.norm(force - np.outer(force @ normal, normal), axis=1)
    edges = np.array([along / np.cos(angle) + sign * aside / np.sin(angle) for sign in (-1, 1)]) / 2
    room = (edges - 1.0 if kind == "friction" else 20.0 - edges).min(axis=0) / (MASS * 9.81)
    place = int(room.argmin())
    found = failing(with_claim(f"{kind} left_rear", *_around(swing, place)))
    if room[_at(swing, place)].max() <= 0.1:
        assert found == set()
    else:
        assert found == {"active contacts"}
    check = verify(Plan.from_json(with_claim(f"{kind} left_rear", *_around(swing, place))))["active contacts"]
    assert check.worst == pytest.approx(room[_at(swing, place)].max(), abs=1e-9)
    assert contact.hold == 2


def _at(phase: Phase, place: int) -> list[int]:
    first = min(place, len(phase.time) - 2)
    return [first, first + 1]


@pytest.mark.parametrize(
    ("path", "value", "complaint"),
    [
        ("method", "guessed", "conic"),
        ("limits/speed/left_hip", 1.0, "velocities are"),
        ("limits/snap", {}, "speed, acceleration, jerk"),
        ("active/0", [1.0, 2.0], "3 entries"),
        ("active/0/0", "now", "number"),
    ],
)
def test_timing_that_cannot_be_understood_is_refused_with_the_field(path: str, value: object, complaint: str) -> None:
    with pytest.raises(PlanFileError, match=r"timing.*" + complaint):
        Plan.from_json(edited(told(), f"{PHASE}/1/timing/{path}", value))
