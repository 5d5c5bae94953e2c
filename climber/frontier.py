"""Where a climb that does not exist ends: what is missing of its goal, how far one gets, and what stops one there."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from climber.balls import balls_meet
from climber.blocked import Blocked, Frontier, GivenUp, on_holds
from climber.geometry import TOUCH
from climber.reachable import Reached, RelaxedClimb, Target
from climber.relaxed import Check, RelaxedChecks, reach_lacking
from climber.solids import away
from climber.stance import Move, Stance, Vector

STANCES = 6  # of the frontier, from which moves onwards are looked at
UNKNOWN = GivenUp("budget", "motion", "given up from every piece of the stance that can be reached")
HOLDS = 6  # looked at for each limb of such a stance


def from_target(target: Target, positions: Vector, points: Vector) -> Vector:
    """Distance of points, shape (..., d), from the middle of a target's holds, or else from its region [m]."""
    if target.demanded:
        result: Vector = np.linalg.norm(points - positions[list(target.demanded)].mean(axis=0), axis=-1)
        return result
    assert target.region is not None
    return away(target.region, points)


class FrontierFinder:
    """Finds the frontier of a climb on what can be reached.

    Args:
        climb: The climb.
        reached: What can be reached.
        barred: By edge of the graph, why it was given up; such edges are not used in `reached`.
    """

    def __init__(self, climb: RelaxedClimb, reached: Reached, barred: Mapping[int, GivenUp] | None = None) -> None:
        self.climb, self.reached, self.barred = climb, reached, dict(barred or {})
        self.checks = RelaxedChecks(climb.wall, climb.robot, climb.robot.limb_names, climb.avoid)
        self.positions = climb.wall.positions[:, : climb.robot.dimension]

    # --- the target --------------------------------------------------------------------------------------------------

    def standing(self, target: Target) -> Check | None:
        """The first check that the target fails by itself, wherever one comes from; None if it passes, or is a region.

        If only a set of holds is asked for, limbs may be on them any way round; the way that fails last is told of.
        """
        if not target.demanded:
            return None
        ways = [target.stance] if target.stance is not None else self._ways_round(target.demanded)
        failures = []
        for stance in ways:
            subject = f"{target.name}, {on_holds(stance)}"
            checks = list(self.checks.of_stance(stance, subject))
            if target.region is not None:
                checks.append(self.checks.region(stance, target.region, subject))
            failure = next(((place, check) for place, check in enumerate(checks) if not check.ok), None)
            if failure is None:
                return None
            failures.append((failure[0], -failure[1].amount, failure[1]))
        return max(failures, key=lambda failure: failure[:2])[2]

    def _ways_round(self, holds: tuple[int, ...]) -> list[Stance]:
        """The holds counter-clockwise around their middle, with every limb at the first in turn."""
        seen = self.climb.wall.projected(np.array(holds))
        offsets = seen - seen.mean(axis=0)
        around = np.array(holds)[np.argsort(np.arctan2(offsets[:, 1], offsets[:, 0]), kind="stable")]
        return [Stance(tuple(np.roll(around, shift).tolist())) for shift in range(len(holds))]

    def most_held(self, target: Target) -> tuple[int, Stance]:
        """How many of a target's holds a reached stance stands on at most, and the first that does."""
        stances = self._stances()
        held = np.isin(stances, target.demanded).sum(axis=1)
        best = int(held.argmax())
        return int(held[best]), Stance(tuple(stances[best].tolist()))

    def region_lacking(self, target: Target) -> tuple[float, Stance]:
        """By how much all limbs would have to be longer for a reached stance to have the pelvis in the region [m].

        A stance cannot do better than its worst limb alone, so stances are tried from the best such bound on.
        """
        assert target.region is not None
        stances, radii = self._stances(), np.asarray(self.climb.robot.reach)
        distances = away(target.region, self.positions)
        bound = (distances[stances] - radii).max(axis=1)
        best, found = np.inf, 0
        for place in np.argsort(bound, kind="stable").tolist():
            if bound[place] >= best:
                break
            lacking, _ = reach_lacking(self.positions[stances[place]], radii, target.region)
            if lacking < best:
                best, found = lacking, place
        return best, Stance(tuple(stances[found].tolist()))

    def no_way_in(self, target: Target) -> Blocked | None:
        """The nearest miss of all moves into a target that can be stood on; None if there is a move into it at all."""
        misses: list[Blocked] = []
        alike = np.ptp(self.climb.robot.reach) <= TOUCH  # then the checks are the same all ways round
        ways = [target.stance] if target.stance is not None else self._ways_round(target.demanded)
        for stance in ways[:1] if alike else ways:
            others = np.setdiff1d(np.arange(len(self.positions)), stance.holds)
            for limb in range(len(stance.holds)):
                for hold in self._near(stance, limb, others):
                    before = stance.moved(limb, hold)
                    subject = f"the stance before, {on_holds(before)}"
                    # Whether one could stand still on the stance before does not decide about the move.
                    checks = (check for check in self.checks.of_stance(before, subject) if check.name != "support")
                    move = Move(before, limb, stance.holds[limb])
                    failure = self.checks.first_failure(checks) or self.checks.first_failure(self.checks.of_move(move))
                    if failure is None:
                        return None
                    misses.append(Blocked(move, failure))
        return min(misses, key=self._miss, default=None)

    def _near(self, stance: Stance, limb: int, others: NDArray[np.int64]) -> list[int]:
        """The holds that a limb could leave for its hold in a stance as far as reach goes, or else the nearest one."""
        if not len(others):
            return []
        radii = self.climb.robot.reach
        feet = np.column_stack([np.tile(stance.holds, (len(others), 1)), others])  # (num_others, n + 1)
        reach = np.append(radii, radii[limb])
        if len(radii) == 2:  # it hangs from one meanwhile, and swings round
            feet, reach = np.delete(feet, limb, axis=1), np.delete(reach, limb)
        near = others[balls_meet(self.positions[feet], reach)].tolist()
        if near:
            return list(near)
        staying = self.positions[np.delete(stance.holds, limb)].mean(axis=0)
        return [int(others[np.linalg.norm(self.positions[others] - staying, axis=1).argmin()])]

    # --- the frontier ------------------------------------------------------------------------------------------------

    def find(self, target: Target) -> Frontier:
        """The frontier towards a target."""
        stances = self._stances()
        middles = self.positions[stances].mean(axis=1)
        near = from_target(target, self.positions, middles)
        # Of stances on the same holds the first will do: what blocks one blocks the others.
        order = np.argsort(near, kind="stable")
        _, first = np.unique(np.sort(stances[order], axis=1), axis=0, return_index=True)
        nearest = order[np.sort(first)[:STANCES]]
        holds = np.array(sorted(self.reached.holds))
        blocked: list[Blocked] = []
        for place in nearest.tolist():
            blocked += self._onwards(Stance(tuple(stances[place].tolist())), float(near[place]), near.min(), target)
        return Frontier(
            reached=len(stances),
            holds=tuple(holds.tolist()),
            farthest_hold=int(holds[from_target(target, self.positions, self.positions[holds]).argmin()]),
            stances=tuple(Stance(tuple(stances[place].tolist())) for place in nearest),
            distances=tuple(near[nearest].tolist()),
            blocked=tuple(sorted(blocked, key=self._miss)),
        )

    def _stances(self) -> NDArray[np.int32]:
        result: NDArray[np.int32] = self.reached.graph.stances[self.reached.vertices]
        return result

    def _onwards(self, stance: Stance, distance: float, nearest: float, target: Target) -> list[Blocked]:
        """Moves from a stance that would lead on to the target, into stances that are not reached.

        They take a hold that the target asks for, or bring the stance nearer to it, by a hold that is not reached or to
        where no reached stance is.
        """
        found = []
        fresh = ~np.isin(np.arange(len(self.positions)), list(self.reached.holds))
        for limb, released in enumerate(stance.holds):
            ends = np.array([[*stance.holds]] * len(self.positions))
            ends[:, limb] = np.arange(len(self.positions))
            then = from_target(target, self.positions, self.positions[ends].mean(axis=1))
            nearer = (then < distance - 1e-9) & (fresh | (then < nearest - 1e-9))
            wanted = np.isin(np.arange(len(self.positions)), target.demanded)
            onwards = wanted if released in target.demanded else nearer | wanted
            onwards[list(stance.holds)] = False
            staying = self.positions[np.delete(stance.holds, limb)].mean(axis=0)
            holds = np.flatnonzero(onwards)
            order = np.argsort(np.linalg.norm(self.positions[holds] - staying, axis=1), kind="stable")
            for hold in holds[order][:HOLDS].tolist():
                move = Move(stance, limb, hold)
                if not self.reached.has(move.end):
                    found.append(self._blocked(move))
        return found

    def _blocked(self, move: Move) -> Blocked:
        failure = self.checks.first_failure(self.checks.of_move(move))
        if failure is not None:
            return Blocked(move, failure)
        graph = self.reached.graph
        edge = graph.edge(graph.vertex(move.start), graph.vertex(move.end))
        return Blocked(move, None, self.barred.get(edge, UNKNOWN))

    def _miss(self, blocked: Blocked) -> tuple[float, Move]:
        """How near a blocked move is to being possible: its shortfall as a share of the reach or the weight."""
        check = blocked.check
        if check is None:  # it passes every relaxed check
            budget = blocked.given_up is not None and blocked.given_up.kind == "budget"
            return (0.0 if budget else 0.001), blocked.move
        if not check.unit:
            return 1.0, blocked.move
        reach = float(np.mean(self.climb.robot.reach))
        scale = reach if check.unit == "m" else float(check.numbers["weight"]) or 1.0
        return check.amount / scale, blocked.move
