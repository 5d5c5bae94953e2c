"""Whole moves refined: shorter together than one by one, and never worse or less feasible than what was there."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from climbs import beginning
from hypothesis import given, settings
from hypothesis import strategies as st

from climber.curve import Curve, rounded
from climber.manifold import Manifold
from climber.phases import instants
from climber.programs.trajectory import NUM_CONTROL, refine
from climber.programs.whole_move import Meeting, MoveProgram, refine_together
from climber.rrt import clear
from climber.stance import Vector
from climber.transition import between

seeds = st.integers(0, 2**32 - 1)
FINE = 0.005  # [rad] four times finer than curves are checked when they are made
Parts = list[tuple[Manifold, Curve]]


def moved(q: Vector, manifold: Manifold, rng: np.random.Generator, size: float) -> Vector:
    """A feasible posture near another, or that one."""
    chart = manifold.chart(q)
    at = chart.coordinates(q)
    u = at + rng.normal(0.0, size, (100, len(at))) / chart.scale
    other, reach = chart.expand(u)
    good = (reach > manifold.margins.reach) & (manifold.slack(other) >= 0)
    return np.asarray(other[good][0]) if good.any() else q


def parts(seed: int, size: float = 0.15) -> tuple[Parts, list[Meeting]]:
    """A shift, a swing and a shift between postures somewhat off those of a climb, each curve refined by itself."""
    rng = np.random.default_rng(seed)
    _, way = beginning()
    at = 2 * int(rng.integers(3))
    window = slice(at, at + 3)
    ends = [moved(i.q, i.manifold, rng, size) for i in instants(way.stretches, way.postures)[at : at + 4]]
    found: Parts = []
    for stretch, old, (a, b) in zip(way.stretches[window], way.curves[window], pairwise(ends), strict=True):
        chart = old[0].chart
        u = np.stack([chart.coordinates(a), chart.coordinates(b)])
        curve = refine(stretch.manifold, chart, u) if clear(stretch.manifold, chart, u[0], u[1]) else None
        if curve is None:
            return parts(seed + 1, size / 2)
        if len(curve.control) < NUM_CONTROL:
            curve = rounded(chart, curve.control[[0, -1]], NUM_CONTROL)
        found.append((stretch.manifold, curve))
    meetings = [Meeting(between(one, two)) for (one, _), (two, _) in pairwise(found)]
    return found, meetings


def total(curves: list[Curve]) -> float:
    return sum(curve.length for curve in curves)


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_refined_curves_are_no_longer_and_no_less_feasible_and_begin_and_end_where_they_did(seed: int) -> None:
    """Looked at four times as closely as when they were made."""
    given_, meetings = parts(seed)
    norm = beginning()[0].objective.norm
    found = refine_together(given_, meetings, norm)
    assert total(found) <= total([curve for _, curve in given_]) + 1e-9
    for (manifold, before), after in zip(given_, found, strict=True):
        assert after.chart is before.chart
        least = manifold.slack(after.q(after.grid(FINE))).min()
        assert least >= min(0.0, manifold.slack(before.q(before.grid(FINE))).min()) - 1e-4
    for meeting, (one, two) in zip(meetings, pairwise(found), strict=True):
        q = one.q(np.ones(1))
        assert two.q(np.zeros(1)) == pytest.approx(q, abs=1e-9)
        assert meeting.manifold.slack(q)[0] >= -1e-9
        for i, point in meeting.manifold.points.items():
            assert np.linalg.norm((meeting.manifold.body.kinematics.feet(q)[0, i] - point)[:2]) < 1e-9
    assert np.array_equal(found[0].control[0], given_[0][1].control[0])
    assert np.array_equal(found[-1].control[-1], given_[-1][1].control[-1])


def test_moving_the_postures_they_meet_in_makes_curves_shorter_than_they_are_alone() -> None:
    gains = []
    for seed in range(4):
        given_, meetings = parts(seed)
        norm = beginning()[0].objective.norm
        alone = refine_together(given_, [Meeting(m.manifold, free=False) for m in meetings], norm)
        together = refine_together(given_, meetings, norm)
        gains.append(total(alone) - total(together))
    assert np.mean(gains) > 0.05 and min(gains) > -0.01


def test_a_meeting_that_is_not_free_stays() -> None:
    given_, meetings = parts(1)
    found = refine_together(given_, [Meeting(m.manifold, free=False) for m in meetings], beginning()[0].objective.norm)
    for (_, before), after in zip(given_, found, strict=True):
        assert np.array_equal(after.control[[0, -1]], before.control[[0, -1]])


def test_curves_that_are_infeasible_come_back_as_they_were() -> None:
    """With the pelvis pulled aside amid the shift until its centre of mass is unsupported."""
    given_, meetings = parts(2)
    manifold, curve = given_[0]
    control = curve.control.copy()
    control[4:-4, 0] += 0.5
    bad = Curve(curve.chart, control, curve.degree)
    assert not bad.feasible(manifold)
    found = refine_together([(manifold, bad), *given_[1:]], meetings, beginning()[0].objective.norm)
    feasible = all(c.feasible(m) for (m, _), c in zip(given_, found, strict=True))
    assert feasible or found[0] is bad


@pytest.mark.parametrize("seed", [0, 3])
def test_gradient_of_the_subproblem_is_that_of_the_cost(seed: int) -> None:
    given_, meetings = parts(seed)
    program = MoveProgram(given_, meetings, beginning()[0].objective.norm)
    curves = [curve for _, curve in given_]
    rng = np.random.default_rng(seed)
    problem = program.subproblem(curves, program._start, 0.3, 1e-4)
    for _ in range(5):
        x = rng.normal(size=len(problem.c))
        h = 1e-6
        ahead, behind = (program.cost(program._moved(curves, program._start, s * h * x)[0]) for s in (1, -1))
        assert problem.c @ x == pytest.approx((ahead - behind) / (2 * h), rel=1e-3, abs=1e-3)


def test_as_many_meetings_as_there_are_gaps() -> None:
    given_, meetings = parts(0)
    with pytest.raises(ValueError, match="3 curves meet 2 times, not 1"):
        MoveProgram(given_, meetings[:1], beginning()[0].objective.norm)
