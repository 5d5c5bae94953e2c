"""The thesis's motion planner for one swing (Gönen 2021, section 4.4), with OMPL 2. Kept plain on purpose.

The robot's eleven coordinates are eight joints, then the pelvis's position and angle. The three supporting legs make
six equations, handed to OMPL as a constraint with its Jacobian; OMPL projects onto them (`ProjectedStateSpace`) and
plans by RRT-Connect. Start and goals are drawn at random in the box of the coordinates, projected by least squares onto
the eight equations of all four legs, and kept if the centre of mass is where three legs can hold the robot. The thesis
finds goals while it plans; OMPL's Python bindings deadlock on goals sampled in a thread, so they are found before.

As in the thesis, the callbacks are Python. They take their sines one by one: for six equations that is twice as fast
as numpy.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.peers.thesis_graph import Interval, State, ThesisGraph

PELVIS_MASS, LINK_MASS = 1.2, 0.1  # [kg]
JOINT_LIMIT = math.radians(150)
NUM_COORDINATES = 11
Vector = NDArray[np.float64]


@dataclass(frozen=True)
class PeerSwing:
    """What came out, and the time it took.

    Attributes:
        outcome: "solved", "timeout", "no start" or "no goal".
        start_seconds: Time to find a posture to let go in [s].
        goal_seconds: Time to find the postures to take hold in [s].
        plan_seconds: Time of RRT-Connect [s].
        callback_seconds: Of that, in the Python callbacks [s].
        goals: Postures to take hold in that were found.
        length: Length of the path in the eleven coordinates [m, rad].
        residual: Worst distance of a supporting foot from its hold, in x or y [m].
        balanced: Share of the path's states with the centre of mass where three legs hold the robot.
    """

    outcome: str
    start_seconds: float = 0.0
    goal_seconds: float = 0.0
    plan_seconds: float = 0.0
    callback_seconds: float = 0.0
    goals: int = 0
    length: float = math.nan
    residual: float = math.nan
    balanced: float = math.nan


@dataclass(frozen=True)
class Geometry:
    """The planar robot: a pelvis of radius r with legs of two links at the angles gamma."""

    r: float
    l1: float
    l2: float
    gamma: tuple[float, ...]

    @staticmethod
    def of(wall: dict) -> Geometry:
        robot = wall["robot"]
        return Geometry(robot["r"], robot["l1"], robot["l2"], tuple(math.radians(a) for a in robot["gamma_deg"]))

    def center_of_mass(self, q: Sequence[float]) -> float:
        """Its abscissa [m]."""
        moment = PELVIS_MASS * q[8]
        for leg, gamma in enumerate(self.gamma):
            a = gamma + q[10]
            b = a + q[2 * leg]
            hip, knee = q[8] + self.r * math.cos(a), self.l1 * math.cos(b)
            moment += LINK_MASS * (2 * hip + 1.5 * knee + 0.5 * self.l2 * math.cos(b + q[2 * leg + 1]))
        return moment / (PELVIS_MASS + 2 * len(self.gamma) * LINK_MASS)


class Contacts:
    """The closed-chain equations of some legs on their holds, and their Jacobian."""

    def __init__(self, robot: Geometry, legs: Sequence[int], points: Sequence[Sequence[float]]) -> None:
        self.robot, self.legs, self.points = robot, tuple(legs), [tuple(map(float, p)) for p in points]
        self.size = 2 * len(self.legs)

    def residual(self, q: Vector, out: Vector) -> None:
        robot, place, values = self.robot, q.tolist(), []
        for leg, (x, y) in zip(self.legs, self.points, strict=True):
            a = robot.gamma[leg] + place[10]
            b = a + place[2 * leg]
            c = b + place[2 * leg + 1]
            values.append(place[8] + robot.r * math.cos(a) + robot.l1 * math.cos(b) + robot.l2 * math.cos(c) - x)
            values.append(place[9] + robot.r * math.sin(a) + robot.l1 * math.sin(b) + robot.l2 * math.sin(c) - y)
        out[:] = values

    def jacobian(self, q: Vector, out: Vector) -> None:
        robot, place = self.robot, q.tolist()
        rows = [[0.0] * NUM_COORDINATES for _ in range(self.size)]
        for i, leg in enumerate(self.legs):
            a = robot.gamma[leg] + place[10]
            b = a + place[2 * leg]
            c = b + place[2 * leg + 1]
            s1, c1 = robot.l1 * math.sin(b), robot.l1 * math.cos(b)
            s2, c2 = robot.l2 * math.sin(c), robot.l2 * math.cos(c)
            of_x, of_y = rows[2 * i], rows[2 * i + 1]
            of_x[2 * leg], of_x[2 * leg + 1], of_x[8], of_x[10] = -s1 - s2, -s2, 1.0, -robot.r * math.sin(a) - s1 - s2
            of_y[2 * leg], of_y[2 * leg + 1], of_y[9], of_y[10] = c1 + c2, c2, 1.0, robot.r * math.cos(a) + c1 + c2
        out[:] = rows

    def project(self, q: Vector, lower: Vector, upper: Vector) -> Vector | None:
        """Least squares from `q` within the bounds."""

        def residual(at: Vector) -> Vector:
            out = np.empty(self.size)
            self.residual(at, out)
            return out

        def jacobian(at: Vector) -> Vector:
            out = np.empty((self.size, NUM_COORDINATES))
            self.jacobian(at, out)
            return out

        found = least_squares(
            residual, q, jac=jacobian, bounds=(lower, upper), xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=100
        )
        return found.x if np.abs(found.fun).max() < 1e-6 else None


class ThesisSwing:
    """One leg goes from one hold to another while the other three hold on."""

    def __init__(self, wall: dict, before: State, after: State) -> None:
        self.robot = Geometry.of(wall)
        (self.leg,) = (i for i in range(4) if before[i] != after[i])
        support = [i for i in range(4) if i != self.leg]
        xy = [(hold["x"], hold["y"]) for hold in wall["holds"]]
        graph = ThesisGraph(wall)
        holding = graph.solve_interval(tuple(before[i] for i in support))
        self.holding = holding
        self.leaving = _common(holding, graph.solve_interval(before))
        self.arriving = _common(holding, graph.solve_interval(after))
        self.swing = Contacts(self.robot, support, [xy[before[i]] for i in support])
        self.start = Contacts(self.robot, range(4), [xy[hold] for hold in before])
        self.goal = Contacts(self.robot, range(4), [xy[hold] for hold in after])
        center = np.mean([*self.start.points, xy[after[self.leg]]], axis=0)
        turn = math.pi / 2
        self.lower = np.array([-JOINT_LIMIT] * 8 + [*(center - 0.25), -turn])
        self.upper = np.array([JOINT_LIMIT] * 8 + [*(center + 0.25), turn])

    def posture(self, contacts: Contacts, interval: Interval, rng: np.random.Generator, tries: int) -> Vector | None:
        """A balanced posture on all four holds."""
        if interval is None:
            return None
        for _ in range(tries):
            q = contacts.project(rng.uniform(self.lower, self.upper), self.lower, self.upper)
            if q is not None and interval[0] <= self.robot.center_of_mass(q) <= interval[1]:
                return q
        return None

    def plan(self, seed: int, time_limit: float = 60.0, num_goals: int = 20) -> PeerSwing:
        """Plans the swing.

        Args:
            seed: Of numpy's and of OMPL's random numbers.
            time_limit: For the goals, and again for RRT-Connect [s].
            num_goals: Postures to take hold in that are looked for.
        """
        rng = np.random.default_rng(seed)
        began = time.perf_counter()
        start = self.posture(self.start, self.leaving, rng, 5000)
        start_seconds = time.perf_counter() - began
        if start is None:
            return PeerSwing("no start", start_seconds)
        began = time.perf_counter()
        goals: list[Vector] = []
        while len(goals) < num_goals and time.perf_counter() - began < time_limit:
            goal = self.posture(self.goal, self.arriving, rng, 20)
            if goal is not None:
                goals.append(goal)
        goal_seconds = time.perf_counter() - began
        if not goals:
            return PeerSwing("no goal", start_seconds, goal_seconds)
        return self._connect(start, goals, seed, time_limit, start_seconds, goal_seconds)

    def _connect(
        self,
        start: Vector,
        goals: Sequence[Vector],
        seed: int,
        time_limit: float,
        start_seconds: float,
        goal_seconds: float,
    ) -> PeerSwing:
        from ompl import base, geometric, util

        util.setLogLevel(util.LogLevel.LOG_NONE)
        util.RNG.setSeed(seed + 1)
        contacts, robot, callbacks, clock = self.swing, self.robot, [0.0], time.perf_counter
        assert self.holding is not None
        least, most = self.holding

        class ClosedChain(base.Constraint):
            def __init__(self) -> None:
                super().__init__(NUM_COORDINATES, contacts.size, 1e-4)

            def function(self, x: Vector, out: Vector) -> None:
                began = clock()
                contacts.residual(x, out)
                callbacks[0] += clock() - began

            def jacobian(self, x: Vector, out: Vector) -> None:
                began = clock()
                contacts.jacobian(x, out)
                callbacks[0] += clock() - began

        def valid(state: Sequence[float]) -> bool:
            began = clock()
            q = [state[i] for i in range(NUM_COORDINATES)]
            good = all(abs(joint) <= JOINT_LIMIT for joint in q[:8]) and least <= robot.center_of_mass(q) <= most
            callbacks[0] += clock() - began
            return good

        space, bounds = base.RealVectorStateSpace(NUM_COORDINATES), base.RealVectorBounds(NUM_COORDINATES)
        for i, (low, high) in enumerate(zip(self.lower.tolist(), self.upper.tolist(), strict=True)):
            bounds.setLow(i, low)
            bounds.setHigh(i, high)
        space.setBounds(bounds)
        constraint = ClosedChain()
        projected = base.ProjectedStateSpace(space, constraint)
        information = base.ConstrainedSpaceInformation(projected)
        projected.setDelta(0.05)
        setup = geometric.SimpleSetup(information)
        setup.setStateValidityChecker(valid)

        def state(q: Vector) -> base.State:
            result = projected.allocState()
            result.copy(q.tolist())
            return result

        setup.addStartState(state(start))
        goal_states = base.GoalStates(information)
        for q in goals:
            goal_states.addState(state(q))
        setup.setGoal(goal_states)
        setup.setPlanner(geometric.RRTConnect(information))
        setup.setup()
        began = clock()
        setup.solve(time_limit)
        spent = clock() - began
        times = start_seconds, goal_seconds, spent, callbacks[0], len(goals)
        if not setup.haveExactSolutionPath():
            return PeerSwing("timeout", *times)
        path = setup.getSolutionPath()
        path.interpolate()
        q = np.array([[s[i] for i in range(NUM_COORDINATES)] for s in path.getStates()])
        return PeerSwing("solved", *times, *self._checked(q))

    def _checked(self, q: Vector) -> tuple[float, float, float]:
        """Length, residual and share balanced of a path, shape (K, 11)."""
        residual, out, balanced = 0.0, np.empty(self.swing.size), 0
        assert self.holding is not None
        for row in q:
            self.swing.residual(row, out)
            residual = max(residual, float(np.abs(out).max()))
            balanced += self.holding[0] - 1e-9 <= self.robot.center_of_mass(row.tolist()) <= self.holding[1] + 1e-9
        return float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum()), residual, balanced / len(q)


def _common(one: Interval, other: Interval) -> Interval:
    if one is None or other is None:
        return None
    lower, upper = max(one[0], other[0]), min(one[1], other[1])
    return (lower, upper) if lower <= upper else None
