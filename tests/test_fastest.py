"""Legs timed: within limits and with a reserve, at rest at both ends; where it is impossible, it says where and why."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from robots import robot, standing
from test_torque import STANDING, feet, variant
from test_torque import robot as _fixture  # noqa: F401

from climber.chart import Chart
from climber.curve import Curve
from climber.dynamics import evaluate
from climber.exceptions import ModelError
from climber.fastest import HOLDING, MARGIN, RESERVE, SHORTEST, FastLeg, RateLimits, fastest_leg, instants_of
from climber.manifold import Body
from climber.phase_motion import MotionBudget, by_fixed_law, timed
from climber.programs import torque_blocks
from climber.programs.time_scaling import TimeScalingProgram
from climber.programs.torque import TorqueBatch, phase_torques
from climber.robot import Robot
from climber.stance import Contact, Vector
from climber.timing import PacedPath, Samples
from climber.verify_motion import drift
from climber.wall import Hold, Wall

PACE = 0.9
JERK = MotionBudget().jerk


@dataclass(frozen=True)
class Leg:
    """A straight shift of the pelvis on friction holds under the feet.

    Attributes:
        body: The robot on these holds.
        contacts: Those that hold.
        path: The leg.
    """

    body: Body
    contacts: tuple[Contact, ...]
    path: PacedPath

    def fastest(self, pace: float = PACE) -> FastLeg | str | None:
        return fastest_leg(self.body, self.contacts, self.path, RateLimits.of(self.body.robot, pace, JERK))


def shifting(
    way: tuple[float, float, float],
    friction: tuple[float, ...] = (0.8,) * 4,
    air: int | None = None,
    lean: tuple[float, ...] = (0.0,) * 4,
    machine: Robot | None = None,
    min_force: float = 0.5,
) -> Leg:
    """The quadruped's pelvis goes `way` (x, y, angle) [m, rad] from its standing posture.

    Args:
        way: Where to.
        friction: Coefficient of each limb's hold.
        air: A limb that does not hold.
        lean: Of each hold's normal from straight up towards -x [rad].
        machine: The robot.
        min_force: Least force along the edges of the cones [N].
    """
    machine = machine or robot("quadruped")
    holds = tuple(
        Hold(tuple(foot), (-np.sin(a), np.cos(a), 0.0), mu, min_force=min_force, max_force=20.0)
        for foot, mu, a in zip(feet(machine, STANDING), friction, lean, strict=True)
    )
    body = Body(machine, Wall(holds))
    contacts = tuple(Contact(i, i) for i in range(4) if i != air)
    chart = Chart(body, {c.limb: body.wall.point(c) for c in contacts}, body.branches(STANDING))
    start = chart.coordinates(STANDING)
    step = np.zeros(len(start))
    step[:3] = way
    control = start + np.linspace(0.0, 1.0, 6)[:, None] * step
    assert chart.expand(control)[1].min() > 0.003  # [m] legs are not straight on the way
    return Leg(body, contacts, PacedPath(Curve(chart, control)))


WAYS = st.tuples(st.floats(-0.02, 0.02), st.floats(-0.015, 0.015), st.floats(-0.15, 0.15))
FRICTIONS = st.tuples(*[st.floats(0.1, 1.2)] * 4)
LEANS = st.tuples(*[st.floats(-0.4, 0.4)] * 4)


def made(leg: Leg, samples: Samples, faster: float = 1.0) -> TorqueBatch:
    """Forces and torques, by another program, that make a motion or the same one so many times as fast."""
    dynamics = evaluate(leg.body.robot, samples.q, faster * samples.v, [c.limb for c in leg.contacts])
    return phase_torques(leg.body.robot, leg.body.wall, leg.contacts, dynamics, faster**2 * samples.vd, MARGIN)


@settings(max_examples=25, deadline=None)
@given(way=WAYS, friction=FRICTIONS, lean=LEANS, air=st.sampled_from([None, 2, 3]))
@example((0.015625, 0.0, 0.0), (0.125, 0.125, 0.25, 1.0), (0.125, 0.03125, 0.25, 0.0), 3)  # fastest right at the start
def test_a_leg_keeps_its_limits_with_a_reserve(
    way: tuple[float, float, float], friction: tuple[float, ...], lean: tuple[float, ...], air: int | None
) -> None:
    """It does where it was looked at, and nearly so in between, where its own accelerations are within limits."""
    leg = shifting(way, friction, air, lean)
    fast = leg.fastest()
    if not isinstance(fast, FastLeg):
        return
    samples = fast.samples(fast.duration, 81)
    limits = RateLimits.of(leg.body.robot, PACE, JERK)
    assert limits.slowing(samples) < 1.1
    assert made(leg, samples).ok.all()
    assert made(leg, fast.at(fast.law.time(fast.x)), 1 / np.sqrt(RESERVE)).ok.all()
    assert made(leg, samples, 1 / np.sqrt(1.1 * RESERVE)).violation.max() < 0.02  # [N, N m]


@settings(max_examples=25, deadline=None)
@given(way=WAYS, friction=FRICTIONS, lean=LEANS, air=st.sampled_from([None, 2, 3]))
def test_half_the_friction_never_makes_a_leg_faster(
    way: tuple[float, float, float], friction: tuple[float, ...], lean: tuple[float, ...], air: int | None
) -> None:
    whole, half = (shifting(way, tuple(f * mu for mu in friction), air, lean).fastest() for f in (1.0, 0.5))
    if isinstance(half, FastLeg):
        assert isinstance(whole, FastLeg)
        # To the accuracy of the rounds that find a jerk-limited motion.
        assert half.duration >= whole.duration * (1 - 0.02)


@settings(max_examples=15, deadline=None)
@given(way=WAYS, friction=FRICTIONS, lean=LEANS, air=st.sampled_from([None, 2, 3]), strong=st.floats(0.3, 1.0))
def test_forces_are_left_out_of_the_program_only_where_they_make_no_difference(
    way: tuple[float, float, float],
    friction: tuple[float, ...],
    lean: tuple[float, ...],
    air: int | None,
    strong: float,
) -> None:
    leg = shifting(way, tuple(strong * mu for mu in friction), air, lean)
    fast = leg.fastest()

    def with_all_forces(*args: Any, forces: Vector, **kwargs: Any) -> TimeScalingProgram:
        return TimeScalingProgram(*args, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("climber.fastest.TimeScalingProgram", with_all_forces)
        whole = leg.fastest()
    if not isinstance(fast, FastLeg) or not isinstance(whole, FastLeg):
        assert type(fast) is type(whole)
        return
    # To the accuracy of the rounds that find a jerk-limited motion.
    assert fast.duration == pytest.approx(whole.duration, rel=0.02)


@cache
def a_leg() -> Leg:
    return shifting((0.03, 0.01, 0.2))


def test_a_leg_begins_and_ends_with_neither_speed_nor_acceleration() -> None:
    fast = a_leg().fastest()
    assert isinstance(fast, FastLeg)
    samples = fast.samples(fast.duration, 101)
    assert np.abs(samples.v[[0, -1]]).max() < 1e-12 and np.abs(samples.vd[[0, -1]]).max() < 1e-9
    assert samples.q[[0, -1]] == pytest.approx(a_leg().path.samples(1.0, 2).q, abs=1e-12)
    rates = a_leg().body.robot.rates(samples.q, samples.v, samples.vd)
    assert max(float(error.max()) for error in drift(samples, rates)) < 1.0


def test_a_leg_is_faster_than_the_law_of_fixed_shape_that_keeps_to_the_same_limits() -> None:
    fast, limits = a_leg().fastest(), RateLimits.of(a_leg().body.robot, PACE, JERK)
    assert isinstance(fast, FastLeg)
    slow = a_leg().path.samples(fast.duration, 401)
    assert limits.slowing(slow) > 1.1
    assert fast.duration > SHORTEST


def test_at_half_the_pace_a_leg_takes_twice_as_long_unless_friction_slows_it() -> None:
    whole, half = a_leg().fastest(0.8), a_leg().fastest(0.4)
    assert isinstance(whole, FastLeg) and isinstance(half, FastLeg)
    assert half.duration == pytest.approx(2 * whole.duration, rel=0.03)


def test_forces_to_begin_with_are_near_to_some_that_make_the_motion() -> None:
    leg, fast = a_leg(), a_leg().fastest()
    assert isinstance(fast, FastLeg)
    samples = fast.samples(fast.duration, 81)
    dynamics = evaluate(leg.body.robot, samples.q, samples.v, range(4))
    instants = instants_of(leg.body, leg.contacts, dynamics.load(samples.vd), dynamics.J)
    assert instants.imbalance(fast.forces(81)).max() < 0.2
    assert instants.inside(instants.balanced(fast.forces(81))).all()


def test_a_leg_of_no_length_stands_still_for_a_moment() -> None:
    for way in ((0.0, 0.0, 0.0), (1e-7, 0.0, 0.0)):
        leg = shifting(way)
        answer = timed(leg.body, leg.contacts, [leg.path], MotionBudget())
        assert not isinstance(answer, str)
        samples, torques, timing = answer
        assert samples.time[-1] == pytest.approx(SHORTEST)
        assert np.ptp(samples.q, axis=0).max() < 1e-6
        assert torques.ok.all() and timing.method == "conic"


def test_a_motion_is_as_smooth_as_is_asked_for() -> None:
    leg, durations = a_leg(), []
    for jerk in (JERK, JERK / 30.0):
        answer = timed(leg.body, leg.contacts, [leg.path], MotionBudget(jerk=jerk))
        assert not isinstance(answer, str)
        samples, _, timing = answer
        durations.append(samples.time[-1])
        assert timing.limits["jerk"]["right_front_hip"] == pytest.approx(PACE**3 * jerk)
        made = np.abs(np.diff(samples.vd, axis=0)) / np.diff(samples.time)[:, None]
        assert made[:, leg.body.robot.joint_v].max() < 1.03 * jerk
    assert durations[1] > 1.3 * durations[0]


def test_legs_one_after_the_other_have_claims_at_their_own_times() -> None:
    leg = a_leg()
    control = leg.path.samples(1.0, 2).q[::-1]  # and back again
    back = PacedPath(Curve(leg.path.chart, np.linspace(*leg.path.chart.coordinates(control), 6)))
    answers = [timed(leg.body, leg.contacts, paths, MotionBudget()) for paths in ([leg.path], [back], [leg.path, back])]
    (there, _, first), (_, _, then), (both, torques, timing) = (a for a in answers if not isinstance(a, str))
    half = there.time[-1]
    assert both.time[-1] == pytest.approx(2 * half, rel=1e-3)
    assert np.abs(both.q[0] - both.q[-1]).max() < 1e-9 and torques.ok.all()
    claims = sorted((*first.active, *then.later(half).active))
    assert first.active and [name for *_, name in timing.active] == [name for *_, name in claims]
    ends, expected = (np.array([claim[:2] for claim in some]) for some in (timing.active, claims))
    assert ends == pytest.approx(expected, abs=0.01)


def test_by_the_fixed_law_a_leg_takes_longer_and_longer_the_less_friction_there_is() -> None:
    durations = []
    for friction in (0.8, 0.02):
        leg = shifting((0.03, 0.01, 0.2), friction=(friction,) * 4)
        slow, fast = (f(leg.body, leg.contacts, [leg.path], MotionBudget()) for f in (by_fixed_law, timed))
        assert not isinstance(slow, str) and not isinstance(fast, str)
        assert slow[1].ok.all() and slow[2].method == "paced" and not slow[2].active
        # Where friction is scarce the law of fixed shape is the faster one, having nothing in reserve.
        assert friction < 0.8 or slow[0].time[-1] > fast[0].time[-1]
        durations.append(slow[0].time[-1])
    assert durations[1] > durations[0]
    answer = by_fixed_law(leg.body, leg.contacts, [leg.path], MotionBudget(slowest=0.9 * durations[1]))
    assert isinstance(answer, str) and "friction cone" in answer


def test_pins_that_take_moments_beside_holds_that_do_not_leave_the_program_room() -> None:
    leg = shifting((0.02, -0.01, 0.1))
    first, *others = leg.body.wall.holds
    durations = {}
    for moment in (0.0, 0.3):
        wall = Wall((replace(first, grip="pin", max_moment=moment), *others))
        timing = timed(Body(leg.body.robot, wall), leg.contacts, [leg.path], MotionBudget())
        assert not isinstance(timing, str)
        samples, torques, how = timing
        assert how.method == "conic"
        assert not torques.moment[:, 1:].any()
        durations[moment] = samples.time[-1]
    assert durations[0.3] <= 1.001 * durations[0.0]


def test_a_place_where_the_robot_cannot_stand_is_named_with_the_limb_that_slips() -> None:
    """The pelvis goes sideways until three feet hold it no more: its end is the worst place."""
    leg = shifting((0.03, 0.0, 0.0), friction=(0.3,) * 4, air=3, min_force=2.0)
    answer = leg.fastest()
    assert isinstance(answer, str)
    assert answer.startswith("the robot cannot stand still at ")
    share = float(answer.split(" at ")[1].split("%")[0])
    assert share == 100.0
    assert any(f"friction {name}, by" in answer for name in leg.body.robot.limb_names)
    assert timed(leg.body, leg.contacts, [leg.path], MotionBudget()) == answer


def test_a_motor_that_cannot_hold_the_robot_is_named(tmp_path: Path) -> None:
    weak = variant(robot("quadruped"), tmp_path, ('effort="4.0"', 'effort="0.05"'))
    answer = shifting((0.03, 0.0, 0.0), machine=weak).fastest()
    assert isinstance(answer, str) and "torque limit of" in answer
    assert any(name in answer for name in weak.joint_names)


def test_damping_in_motors_slows_a_leg_and_is_within_their_torques(tmp_path: Path) -> None:
    """So much of it that torques bind."""
    damped = variant(robot("quadruped"), tmp_path, ('damping="0.0"', 'damping="4.0"'))
    leg, free = shifting((0.03, 0.01, 0.2), machine=damped), a_leg().fastest()
    fast = leg.fastest()
    assert isinstance(fast, FastLeg) and isinstance(free, FastLeg)
    assert fast.duration > free.duration
    answer = timed(leg.body, leg.contacts, [leg.path], MotionBudget())
    assert not isinstance(answer, str)
    assert (np.abs(answer[1].torque) <= damped.effort).all()


def test_damping_in_a_joint_without_a_motor_is_refused_by_name(tmp_path: Path) -> None:
    text = robot("quadruped").model.path.read_text()
    motors = re.findall(r"  <transmission>.*?</transmission>\n", text, flags=re.DOTALL)
    knees = [(motor, "") for motor in motors if "_knee" in motor]
    passive = variant(robot("quadruped"), tmp_path, *knees, ('damping="0.0"', 'damping="0.1"'))
    with pytest.raises(ModelError, match=r"variant.urdf.*without a motor.*damped"):
        shifting((0.01, 0.0, 0.0), machine=passive).fastest()


def test_limits_are_the_models_at_full_pace_and_shrink_with_its_powers() -> None:
    machine = robot("quadruped")
    full, half = RateLimits.of(machine, 1.0, JERK), RateLimits.of(machine, 0.5, JERK)
    assert (full.speed[machine.joint_v] == 4.0).all() and (full.acceleration[machine.joint_v] == 60.0).all()
    assert (full.jerk[machine.joint_v] == JERK).all()
    for name, factor in (("speed", 0.5), ("acceleration", 0.25), ("jerk", 0.125)):
        assert getattr(half, name) == pytest.approx(factor * getattr(full, name))
        assert set(full.by_name(machine)[name]) == set(machine.velocity_names)
    holding = RateLimits.of(machine, 1.0, JERK, [1])
    assert holding.speed[machine.limbs[1].v] == pytest.approx(HOLDING * 4.0)
    assert (holding.speed[machine.limbs[0].v] == 4.0).all()


def test_a_motion_beyond_its_limits_is_slowed_by_as_much_as_it_takes() -> None:
    fast, limits = a_leg().fastest(), RateLimits.of(a_leg().body.robot, PACE, JERK)
    assert isinstance(fast, FastLeg)
    for kind, order in (("speed", 1), ("acceleration", 2), ("jerk", 3)):
        tight = replace(limits, **{kind: getattr(limits, kind) / 2.0**order})
        by = tight.slowing(fast.samples(fast.duration, 201))
        assert by > 1.0
        slowed = fast.slowed(by)
        assert tight.slowing(slowed.samples(slowed.duration, 201)) == pytest.approx(1.0, abs=1e-6)


def standing_room(leg: Leg, q: Vector) -> float:
    dynamics = evaluate(leg.body.robot, q[None], 0 * q[None], range(4))
    instants = instants_of(leg.body, leg.contacts, dynamics.load(0 * q[None]), dynamics.J)
    return float(-torque_blocks.least_violation(instants)[1][0])


def test_hardly_any_room_still_leaves_a_timing_if_a_slow_one() -> None:
    """Where the least force is what the robot can just press everywhere."""
    low, high = 0.5, 5.0  # [N] with the one there is room, with the other there is none
    while high - low > 0.02:
        middle = (low + high) / 2
        enough = standing_room(shifting((0.002, 0.0, 0.0), min_force=middle), STANDING) > 0.02
        low, high = (middle, high) if enough else (low, middle)
    slow, fast = shifting((0.002, 0.0, 0.0), min_force=low).fastest(), shifting((0.002, 0.0, 0.0)).fastest()
    assert isinstance(fast, FastLeg) and isinstance(slow, FastLeg)
    assert slow.duration >= fast.duration


@pytest.mark.parametrize("seed", [2, 4])
def test_in_space_a_leg_keeps_to_round_cones_with_a_reserve(seed: int) -> None:
    here = standing("lemur", seed)
    leaning = np.random.default_rng(seed).normal(0.0, 0.2, len(here.contacts))
    holds = tuple(
        replace(hold, grip="friction", friction=0.8, min_force=0.5, max_force=80.0, normal=(lean, 1.0, 0.6))
        for hold, lean in zip(here.body.wall.holds, leaning, strict=True)
    )
    body = Body(here.body.robot, Wall(holds))
    chart = here.manifold.chart(here.q)
    start = chart.coordinates(here.q)
    control = start + np.linspace(0.0, 1.0, 6)[:, None] * np.linspace(-0.02, 0.02, len(start))
    answer = timed(body, here.contacts, [PacedPath(Curve(chart, control))], MotionBudget())
    assert not isinstance(answer, str)
    samples, torques, timing = answer
    assert timing.method == "conic"
    for hold, force in zip(holds, np.moveaxis(torques.force, 1, 0), strict=True):
        normal = np.array(hold.normal) / np.linalg.norm(hold.normal)
        along = force @ normal
        across = np.linalg.norm(force - np.outer(along, normal), axis=1)
        narrow = np.cos(np.arctan(hold.friction))
        assert (across <= 0.8 * (along - 2 * 0.5 * narrow)).all()
        assert (across <= 0.8 * (2 * 80.0 * narrow - along)).all()
    dynamics = evaluate(body.robot, samples.q, samples.v, range(4))
    lambdas = torques.force.reshape(len(samples.time), -1)
    assert np.abs(dynamics.residual(samples.vd, torques.torque, lambdas)).max() < 1e-6
    faster = 1 / np.sqrt(1.1 * RESERVE)
    dynamics = evaluate(body.robot, samples.q, faster * samples.v, range(4))
    assert phase_torques(body.robot, body.wall, here.contacts, dynamics, faster**2 * samples.vd, MARGIN).ok.all()
