"""What the task planner answers: a plan, the proof that there is none, or that it ran out of time. Types only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from climber.states import Integers


@dataclass(frozen=True)
class Attempt:
    """One horizon put to the solver.

    Attributes:
        horizon: Number of steps asked for.
        outcome: "no plan" is proved; "out of time" proves nothing.
        pairs: Pairs (state, number of steps made) it was given that it did not have before.
        moves: Pairs (arc, number of the step) it was given that it did not have before.
        rules: Ground rules it was given that it did not have before.
        ground_seconds: Time to instantiate them [s].
        solve_seconds: Time to search and prove [s].
        models: Plans found, each cheaper than the one before.
        conflicts: Dead ends the search ran into.
    """

    horizon: int
    outcome: Literal["plan", "no plan", "out of time"]
    pairs: int
    moves: int
    rules: int
    ground_seconds: float
    solve_seconds: float
    models: int
    conflicts: int


@dataclass(frozen=True)
class TaskStats:
    """What answering took.

    Attributes:
        shortest: Fewest steps that any robot needs on its own, the most of them, on what is left of its graph: where
            the search begins.
        attempts: The horizons tried, in order.
        pairs: Pairs (state, number of steps made) the solver has been given since the planner was made.
        moves: Pairs (arc, number of the step), likewise.
        layers_seconds: Time for distances and weights [s].
        seconds: Time for everything [s].
    """

    shortest: int | None
    attempts: tuple[Attempt, ...]
    pairs: int
    moves: int
    layers_seconds: float
    seconds: float


@dataclass(frozen=True)
class Proofs:
    """What is proved of a plan, relative to the graphs, less what has been cut, barred or found in conflict so far.

    Attributes:
        makespan_proved: No plan has fewer steps.
        cost_proved: No plan with as many steps costs less.
    """

    makespan_proved: bool
    cost_proved: bool


@dataclass(frozen=True)
class Walk:
    """What one robot does: a step after the other, from its start to a goal.

    Attributes:
        vertices: Where it stands after 0, 1, ... steps; one more than `edges`.
        edges: The edge of each step, as an index into the robot's arrays, or -1 (`climber.states.WAIT`) if it waits.
        components: The component of its vertex that it is in after 0, 1, ... steps, None where that is not split; as
            many as `vertices`.
        visits: For each waypoint, the number of steps after which it is first visited: a place in `vertices`.
        cost: Sum of the costs of the edges, penalties included.
    """

    vertices: tuple[int, ...]
    edges: tuple[int, ...]
    components: tuple[int | None, ...]
    visits: tuple[int, ...]
    cost: int


@dataclass(frozen=True)
class TaskPlan:
    """Walks that all robots take at once, step by step.

    Attributes:
        walks: The walk of each robot, all of the same number of steps.
        cost: Sum of their costs.
        proofs: What is proved of it.
        stats: What it took.
    """

    walks: tuple[Walk, ...]
    cost: int
    proofs: Proofs
    stats: TaskStats

    @property
    def makespan(self) -> int:
        """Number of steps."""
        return len(self.walks[0].edges)

    @property
    def vertices(self) -> tuple[int, ...]:
        """The vertices of the only robot's walk, from the start to a goal."""
        (walk,) = self.walks
        return walk.vertices

    @property
    def edges(self) -> tuple[int, ...]:
        """The edges of the only robot's walk."""
        (walk,) = self.walks
        return walk.edges


@dataclass(frozen=True)
class Impossible:
    """Proof that there is no plan.

    Either one robot alone has no walk: all edges out of what it can reach, which satisfies no goal, are cut or barred.
    Or every robot has one, and they have none together: then all joint positions were searched.

    Attributes:
        reached: The vertices that can be reached, ascending, the start among them, shape (n,). Without waypoints no
            goal is.
        blocking: The cut or barred edges that lead from there to where the robot cannot be, ascending; empty when the
            graph itself ends there, shape (m,).
        frontier: The reached vertices those edges leave, ascending, shape (k,).
        stats: What it took.
        robot: Whose walk it is; None if it takes all robots to see that there is no plan.
        missing: Waypoints of that robot that cannot be reached at all.
        waypoints: How many waypoints that robot has.
        barred: How many of the blocking edges are not cut but barred, between all components.
        joint: Number of joint positions searched, if it takes all robots.
    """

    reached: Integers
    blocking: Integers
    frontier: Integers
    stats: TaskStats
    robot: int | None = 0
    missing: tuple[int, ...] = ()
    waypoints: int = 0
    barred: int = 0
    joint: int = 0

    @property
    def reason(self) -> str:
        """The proof as a sentence."""
        if self.robot is None:
            return (
                f"unreachable: every robot has a way to its goal but they have none together; {self.joint} joint "
                "positions can be reached, and none of them is the end"
            )
        vertices = "1 vertex" if len(self.reached) == 1 else f"{len(self.reached)} vertices"
        cut = "cut or barred" if self.barred else "cut"
        leaving = f"all {len(self.blocking)} edges are {cut} that lead" if len(self.blocking) else "no edge leads"
        if self.missing:
            numbers = " and ".join(str(waypoint) for waypoint in self.missing)
            what = f"waypoint {numbers} is" if len(self.missing) == 1 else f"of waypoints {numbers} none is"
            return f"unreachable: {what} among the {vertices} that can be reached, and {leaving} further"
        if self.waypoints:
            return (
                f"unreachable: no walk visits all waypoints and then a goal; {vertices} can be reached, and {leaving} "
                "to what is missing"
            )
        return f"unreachable: no goal is among the {vertices} that can be reached, and {leaving} out of them"


@dataclass(frozen=True)
class OutOfTime:
    """The time limit came first: whether there is a plan is not known.

    Attributes:
        horizon: Every plan has at least so many steps; whether one has exactly so many is what was being asked.
        stats: What it took.
    """

    horizon: int
    stats: TaskStats
