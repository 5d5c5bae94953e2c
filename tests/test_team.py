"""Several robots on one clock: who waits, who goes first, and what cannot be."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plans import KNEES_OUT, QUADRUPED

from climber.encounter import BETWEEN, Pair, Track
from climber.manifold import Body
from climber.meetings import Conflict
from climber.phase_motion import PhaseMotion
from climber.robot import Model, Robot
from climber.stance import Contact, Vector
from climber.team import Team, TeamMotion, by_step
from climber.timing import Samples
from climber.wall import Wall

ON_ALL = tuple(Contact(limb, limb) for limb in range(4))


@cache
def body() -> Body:
    return Body(Robot(Model.load(QUADRUPED)), Wall([]))


def posture(x: float, y: float = 0.0, turn: float = 0.0) -> Vector:
    q = np.zeros(11)
    q[3:] = KNEES_OUT
    q[:3] = x, y, turn
    return q


def glide(start: Vector, end: Vector, duration: float, limb: int | None = None, move: int = 0) -> PhaseMotion:
    """From one posture to another by the minimum-jerk law; what feet and forces do is of no account here."""
    tau = np.linspace(0.0, 1.0, int(np.ceil(100 * duration)) + 1)
    way = (end - start)[None]
    law, rate, bend = (
        tau**3 * (10 - 15 * tau + 6 * tau**2),
        30 * tau**2 * (1 - tau) ** 2 / duration,
        60 * tau * (1 - tau) * (1 - 2 * tau) / duration**2,
    )
    samples = Samples(duration * tau, start + law[:, None] * way, rate[:, None] * way, bend[:, None] * way)
    contacts = tuple(c for c in ON_ALL if c.limb != limb)
    rng = np.random.default_rng(move)
    force, moment = rng.normal(size=(len(tau), len(contacts), 3)), rng.normal(size=(len(tau), len(contacts)))
    return PhaseMotion(limb, move, contacts, samples, force, np.ones((len(tau), 8)), moment)


def stepping(places: list[Vector], durations: list[float]) -> list[list[PhaseMotion]]:
    """A robot that shifts from place to place, one in each step."""
    pairs = zip(places, places[1:], durations, strict=False)
    return [[glide(a, b, duration, move=i)] for i, (a, b, duration) in enumerate(pairs)]


# --- distances -------------------------------------------------------------------------------------------------------


def test_distances_at_samples_are_the_least_of_all_pairs_of_segments() -> None:
    """Against shapely, on random postures."""
    import shapely

    rng = np.random.default_rng(0)
    pair = Pair(body(), body())
    kinematics, clearance = body().kinematics, body().clearance
    for _ in range(50):
        one, two = (posture(*rng.uniform(-0.2, 0.2, 2), rng.uniform(-3, 3)) for _ in range(2))
        two[0] += 0.25
        for q in (one, two):
            q[3:] += rng.normal(scale=0.5, size=8)
        parts = []
        for q in (one, two):
            poses = kinematics.poses(q[None])
            shapes = []
            for link, pose in enumerate(poses):
                (start,), (end,) = clearance.segments(link, pose)
                lines = zip(start, end, clearance.radii(link), strict=True)
                shapes += [(shapely.LineString([a, b]), r) for a, b, r in lines]
                shapes += [(shapely.Polygon(start[ring]), 0.0) for ring in map(list, clearance.rings(link))]
            parts.append(shapes)
        expected = min(a.distance(b) - r - s for a, r in parts[0] for b, s in parts[1])
        found = pair.nearest(Track.standing(one), Track.standing(two), 0.0).distance
        if expected > 0:
            assert found == pytest.approx(expected, abs=1e-9)
        else:
            assert found <= 0


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), wanted=st.sampled_from([0.0, 0.001, 0.05]))
def test_nothing_that_matters_is_missed_between_samples(seed: int, wanted: float) -> None:
    """The same as if ten instants were looked at between every two samples."""
    rng = np.random.default_rng(seed)
    tracks = []
    for side in (0.0, 0.45):
        time = np.arange(0.0, 0.5, float(rng.uniform(0.007, 0.01)))
        path, speed = rng.uniform(-0.1, 0.1, (2, 3)), rng.uniform(1.0, 6.0, 3)
        where = path[0] + path[1] * np.sin(speed * time[:, None]) * [1.0, 1.0, 5.0]
        tracks.append(Track(time, np.array([posture(side + x, y, turn) for x, y, turn in where])))
    pair = Pair(body(), body())
    samples = np.union1d(tracks[0].time, tracks[1].time)
    part = np.arange(BETWEEN + 1) / (BETWEEN + 1)
    dense = np.append((samples[:-1, None] + np.diff(samples)[:, None] * part).ravel(), samples[-1])
    every = pair.nearest(Track(dense, tracks[0].at(dense)), Track(dense, tracks[1].at(dense)), -1.0).distance
    assert pair.nearest(tracks[0], tracks[1], wanted).distance == pytest.approx(every, abs=1e-6)


def test_an_encounter_says_when_and_which_links() -> None:
    pair = Pair(body(), body())
    still = Track.standing(posture(0.6))
    time = np.linspace(0.0, 2.0, 201)
    there_and_back = np.array([posture(0.1 * np.sin(np.pi * t / 2)) for t in time])
    met = pair.nearest(Track(time, there_and_back), still, 0.0)
    assert met.time == pytest.approx(1.0, abs=0.02)
    assert met.links[0].startswith("right_") and met.links[1].startswith("left_")


def test_robots_on_top_of_each_other_are_not_clear() -> None:
    assert Pair(body(), body()).nearest(Track.standing(posture(0.0)), Track.standing(posture(0.0)), 0.0).distance <= 0


# --- one clock -------------------------------------------------------------------------------------------------------


def test_robots_far_apart_begin_every_step_together_and_wait_for_the_slowest() -> None:
    left = stepping([posture(0.0), posture(0.02), posture(0.03)], [1.0, 0.5])
    right = stepping([posture(2.0), posture(2.02), posture(2.03)], [0.6, 0.9])
    motion = Team([body(), body()]).synchronise([left, right])
    assert isinstance(motion, TeamMotion)
    assert motion.starts == pytest.approx((0.0, 1.0, 1.9))
    assert motion.turns == ()
    for phases in motion.phases:
        assert phases[0].samples.time[0] == 0.0
        assert phases[-1].samples.time[-1] == motion.starts[-1]
    second = motion.phases[1]
    assert second[0].samples.time[-1] == pytest.approx(0.6)
    still = (second[1].samples.time > 0.61) & (second[1].samples.time < 0.99)
    assert still.sum() > 30
    np.testing.assert_array_equal(second[1].samples.q[still], np.repeat(posture(2.02)[None], still.sum(), axis=0))
    assert not second[1].samples.v[still].any() and not second[1].samples.vd[still].any()


def check_timeline(phases: tuple[PhaseMotion, ...], original: list[PhaseMotion]) -> None:
    """Phases follow on one another, are densely sampled, and make the original motions, standing still in between."""
    assert len(phases) == len(original)
    for before, after in pairwise(phases):
        assert after.samples.time[0] == before.samples.time[-1]
        np.testing.assert_array_equal(after.samples.q[0], before.samples.q[-1])
    for phase, motion in zip(phases, original, strict=True):
        count = len(phase.samples.time)
        assert (np.diff(phase.samples.time) > 0).all() and np.diff(phase.samples.time).max() <= 0.01 + 1e-9
        assert phase.force.shape == (count, len(phase.contacts), 3) and phase.torque.shape == (count, 8)
        moving = np.abs(phase.samples.v).max(axis=1) > 0
        within = np.abs(motion.samples.v).max(axis=1) > 0
        np.testing.assert_allclose(phase.samples.q[moving], motion.samples.q[within])
        np.testing.assert_array_equal(phase.force[moving], motion.force[within])
        np.testing.assert_array_equal(phase.moment[moving], motion.moment[within])
        assert phase.moment.shape == (count, len(phase.contacts))
        at_rest = ~moving
        ends = np.array([motion.force[0], motion.force[-1]])
        assert all((phase.force[k] == ends).all(axis=(1, 2)).any() for k in np.flatnonzero(at_rest))


@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_whatever_the_waits_each_robot_makes_its_own_motions_on_the_common_clock(data: st.DataObject) -> None:
    steps = data.draw(st.integers(1, 4))
    team, originals = [], []
    for robot in range(3):
        moving = data.draw(st.lists(st.booleans(), min_size=steps, max_size=steps))
        durations = [data.draw(st.floats(0.1, 0.4)) for _ in range(2 * sum(moving) + 1)]
        places = [posture(2.0 * robot + 0.01 * k) for k in range(len(durations) + 1)]
        kinds = [(None, k // 2) if k % 2 == 0 else (1, k // 2) for k in range(len(durations))]
        pairs = zip(places, places[1:], durations, kinds, strict=False)
        phases = [glide(a, b, duration, limb, move) for a, b, duration, (limb, move) in pairs]
        originals.append(phases)
        team.append(by_step(phases, moving))
    motion = Team([body()] * 3).synchronise(team)
    assert isinstance(motion, TeamMotion)
    for phases, original in zip(motion.phases, originals, strict=True):
        check_timeline(phases, original)
        assert phases[0].samples.time[0] == 0.0
        assert phases[-1].samples.time[-1] == pytest.approx(motion.starts[-1], abs=1e-9)


def test_phases_are_sorted_into_the_steps_in_which_their_moves_are_made() -> None:
    phases = [glide(posture(0), posture(0), 0.1, limb, move) for limb, move in ((None, 0), (2, 0), (None, 1), (1, 1))]
    last = glide(posture(0), posture(0), 0.1, None, 2)
    steps = by_step([*phases, last], [False, True, False, True, False])
    assert steps == [[], phases[:2], [], [*phases[2:], last], []]
    assert by_step([replace(last, move=0)], [False, False]) == [[replace(last, move=0)], []]
    assert by_step([replace(last, move=0)], []) == [[replace(last, move=0)]]


def test_a_lone_robot_keeps_its_motion() -> None:
    own = stepping([posture(0.0), posture(0.1)], [0.5])
    motion = Team([body()]).synchronise([own])
    assert isinstance(motion, TeamMotion)
    np.testing.assert_array_equal(motion.phases[0][0].samples.q, own[0][0].samples.q)


# --- turns and conflicts ---------------------------------------------------------------------------------------------


def width() -> float:
    """How far apart two such robots side by side are when they touch [m]."""
    apart = Pair(body(), body()).nearest(Track.standing(posture(0.0)), Track.standing(posture(1.0)), 0.0).distance
    return 1.0 - apart


def test_robots_that_would_meet_take_turns() -> None:
    """The right one makes room before the left one follows; together they come too near at first."""
    gap, way = width() + 0.005, 0.1
    left = [[glide(posture(0.0), posture(way), 0.3)]]
    right = [[glide(posture(gap), posture(gap + way), 1.0)]]
    motion = Team([body(), body()]).synchronise([left, right])
    assert isinstance(motion, TeamMotion)
    assert motion.turns == (0,)
    assert motion.starts == pytest.approx((0.0, 1.3))
    moving = [np.abs(phases[0].samples.v).max(axis=1) > 0 for phases in motion.phases]
    times = [phases[0].samples.time[m] for phases, m in zip(motion.phases, moving, strict=True)]
    assert times[1].max() < times[0].min()
    assert motion.nearest.distance >= 0.001
    assert motion.robots == (0, 1)


def test_the_least_distance_of_the_plan_is_at_the_time_it_says() -> None:
    gap, way = width() + 0.005, 0.1
    left = [[glide(posture(0.0), posture(way), 0.3)]]
    right = [[glide(posture(gap), posture(gap + way), 1.0)]]
    motion = Team([body(), body()]).synchronise([left, right])
    assert isinstance(motion, TeamMotion)
    tracks = [Track(phases[0].samples.time, phases[0].samples.q) for phases in motion.phases]
    whole = Pair(body(), body()).nearest(tracks[0], tracks[1], 0.0)
    assert motion.nearest.distance == pytest.approx(whole.distance, abs=1e-9)
    at = [Track.standing(track.at(np.array([motion.nearest.time]))[0]) for track in tracks]
    assert Pair(body(), body()).nearest(at[0], at[1], 0.0).distance == pytest.approx(whole.distance, abs=1e-9)


def test_robots_that_end_on_top_of_each_other_conflict_and_so_do_those_that_swap() -> None:
    team = Team([body(), body()])
    gap = width() + 0.05
    closing = team.synchronise([[[glide(posture(0.0), posture(0.1), 0.3)]], [[glide(posture(gap), posture(gap), 0.3)]]])
    assert isinstance(closing, tuple)
    (conflict,) = closing
    assert (conflict.step, conflict.one, conflict.two, conflict.standing) == (0, (0, "move"), (1, "move"), "end")
    assert conflict.encounter.distance < 0.001
    swap = team.synchronise([[[glide(posture(0.0), posture(1.0), 0.3)]], [[glide(posture(1.0), posture(0.0), 0.3)]]])
    assert isinstance(swap, tuple)
    assert swap[0].standing is None


def test_a_waiting_robot_in_the_way_is_a_conflict_of_a_move_and_a_wait() -> None:
    passing = stepping([posture(0.0), posture(0.0), posture(2.0)], [0.2, 0.5])
    waiting = [[glide(posture(1.0), posture(1.0), 0.2)], []]
    found = Team([body(), body()]).synchronise([passing, waiting])
    assert isinstance(found, tuple)
    assert [(c.step, c.one, c.two, c.standing) for c in found] == [(1, (0, "move"), (1, "at"), None)]


def test_every_step_with_a_conflict_is_reported() -> None:
    near = width() - 0.1
    one = stepping([posture(0.0), posture(0.2), posture(0.0), posture(0.2)], [0.2] * 3)
    two = stepping([posture(near + 0.2)] * 4, [0.2] * 3)
    found = Team([body(), body()]).synchronise([one, two])
    assert isinstance(found, tuple)
    assert [(c.step, c.standing) for c in found] == [(0, "end"), (1, "start"), (2, "end")]


def test_three_robots_in_a_row_follow_one_another_in_the_only_order_there_is() -> None:
    gap, way = width() + 0.005, 0.1
    team = [[[glide(posture(k * gap), posture(k * gap + way), 0.2)]] for k in range(3)]
    motion = Team([body()] * 3).synchronise(team)
    assert isinstance(motion, TeamMotion)
    # All alike and all at once keep their distance; only if one is slower they have to take turns.
    assert motion.turns == ()
    team[2] = [[glide(posture(2 * gap), posture(2 * gap + way), 0.9)]]
    motion = Team([body()] * 3).synchronise(team)
    assert isinstance(motion, TeamMotion)
    assert motion.starts == pytest.approx((0.0, 1.1))
    begins = [phases[0].samples.time[np.abs(phases[0].samples.v).max(axis=1) > 0].min() for phases in motion.phases]
    assert begins[2] < 0.02 and begins[0] == pytest.approx(begins[1]) and begins[0] > 0.9


def test_what_cannot_be_put_on_one_clock_is_refused() -> None:
    team, own = Team([body(), body()]), stepping([posture(0.0), posture(0.1)], [0.5])
    far = stepping([posture(2.0), posture(2.1)], [0.5])
    with pytest.raises(ValueError, match="2 robots"):
        team.synchronise([own])
    with pytest.raises(ValueError, match="one length"):
        team.synchronise([own, [*far, []]])
    with pytest.raises(ValueError, match="no phase"):
        team.synchronise([own, [[]]])
    rushing = replace(own[0][0], samples=replace(own[0][0].samples, v=own[0][0].samples.v + 0.1))
    with pytest.raises(ValueError, match="not at rest"):
        team.synchronise([[[rushing]], far])
    swinging = [[], [glide(posture(2.0), posture(2.1), 0.5, limb=1)]]
    with pytest.raises(ValueError, match="all limbs on"):
        team.synchronise([[*own, []], swinging])


def test_conflicts_name_robots_in_order() -> None:
    found = Team([body(), body()]).synchronise([[[glide(posture(0.0), posture(0.1), 0.3)]]] * 2)
    assert isinstance(found, tuple) and isinstance(found[0], Conflict)
    assert found[0].one[0] < found[0].two[0]
