"""What little change would make a climb of a wall that has none: a better grip, or one hold more.

Every change told of was tried: the stance graph of the changed wall was built anew and has the climb, without the moves
that are proved impossible. Like all that the graph says, that is relaxed; `planned` tells of those whose climb the
planner then really found.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import shapely
from scipy.stats import qmc
from shapely.geometry import MultiPoint, Point
from shapely.geometry.base import BaseGeometry

from climber.blocked import Frontier
from climber.exceptions import ClimberError
from climber.reachable import RelaxedClimb, Target
from climber.scenario import Scenario
from climber.scenario_fields import HoldSpec
from climber.stance import Vector
from climber.wall import Hold, Wall

Planner = Callable[[Scenario, float], bool]  # whether a scenario has a plan, with so many seconds to find it
FRICTION = 0.05  # by how much a coefficient is raised
PLACES = 400  # for one hold more, tried at most
STRONG = 1e4  # a pin of this many times the robot's weight pushes and pulls as one likes


@dataclass(frozen=True)
class Change:
    """A change of the wall that makes a climb on the stance graph.

    Attributes:
        kind: "friction" if the friction of `holds` is raised, "hold" if `added` joins the wall.
        moves: Fewest moves of the climb on the changed wall's stance graph, less those proved impossible.
        holds: Whose friction is raised; the number of the hold that is added.
        added: The hold that is added.
        planned: Whether the planner then found the whole climb; None if it was not asked.
    """

    kind: Literal["friction", "hold"]
    moves: int
    holds: tuple[int, ...]
    added: Hold | None = None
    planned: bool | None = None

    def on(self, wall: Wall) -> Wall:
        """The changed wall."""
        if self.added is not None:
            return replace(wall, holds=(*wall.holds, self.added))
        return more_friction(wall, self.holds)

    def on_scenario(self, scenario: Scenario) -> Scenario:
        """The scenario with the changed wall."""
        common, specs = scenario.wall.hold_defaults, list(scenario.wall.holds)
        if self.added is not None:
            position, normal = list(self.added.position), list(self.added.normal)
            specs.append(HoldSpec(position=position, normal=normal))  # the rest as `hold_defaults` has it
        for number in self.holds if self.added is None else ():
            own = specs[number].friction
            specs[number] = replace(specs[number], friction=(common.friction if own is None else own) + FRICTION)
        return replace(scenario, wall=replace(scenario.wall, holds=specs))

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        facts: dict[str, Any] = {"kind": self.kind, "moves": self.moves, "planned": self.planned}
        if self.added is None:
            return facts | {"holds": list(self.holds), "friction_added": FRICTION}
        fields = ("position", "normal", "friction", "half_width", "min_force", "max_force", "grip", "adhesion")
        return facts | {"hold": {name: getattr(self.added, name) for name in fields}, "number": self.holds[0]}


@dataclass(frozen=True)
class Changes:
    """The changes that were tried.

    Attributes:
        friction: Those of friction that make a climb: of single holds, and of all holds together.
        forces_matter: False if it is proved that no friction would make a climb: geometry alone rules it out.
        friction_tried: Walls with more friction that were tried, all or as many as there was time for.
        friction_all_tried: Whether that was every hold alone and all together.
        holds: One hold more: all places found that make a climb, those of fewest moves first.
        places_tried: Places that were tried.
    """

    friction: tuple[Change, ...] = ()
    forces_matter: bool = True
    friction_tried: int = 0
    friction_all_tried: bool = True
    holds: tuple[Change, ...] = ()
    places_tried: int = 0

    @property
    def hold(self) -> Change | None:
        """One hold more: one the planner found a climb with if there is one, else the first."""
        return next((change for change in self.holds if change.planned), self.holds[0] if self.holds else None)

    def asked(self, planner: Planner, scenario: Scenario, seconds: float) -> Changes:
        """The changes with the planner asked: of each kind the best first, until it has a plan or time is over.

        Args:
            planner: The planner.
            scenario: The scenario that has no climb.
            seconds: For each kind [s].
        """

        def ask(changes: Sequence[Change]) -> tuple[Change, ...]:
            until, told = clock.perf_counter() + seconds, list(changes)
            for i, change in enumerate(changes):
                left = until - clock.perf_counter()
                if left <= 0.0:
                    break
                told[i] = replace(change, planned=planner(change.on_scenario(scenario), left))
                if told[i].planned:
                    break
            return tuple(told)

        friction = sorted(self.friction, key=lambda change: (len(change.holds), change.moves))
        return replace(self, friction=ask(friction), holds=ask(self.holds))

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "friction": {
                "changes": [change.to_dict() for change in self.friction],
                "ruled_out": not self.forces_matter,
                "tried": self.friction_tried,
                "all_tried": self.friction_all_tried,
            },
            "hold": {
                "change": None if self.hold is None else self.hold.to_dict(),
                "places_good": len(self.holds),
                "places_tried": self.places_tried,
            },
        }


def more_friction(wall: Wall, holds: tuple[int, ...]) -> Wall:
    """The wall with the friction of some holds raised by `FRICTION`."""
    better = list(wall.holds)
    for hold in holds:
        better[hold] = replace(better[hold], friction=better[hold].friction + FRICTION)
    return replace(wall, holds=tuple(better))


@dataclass
class ChangeFinder:
    """Tries changes for as long as there is time.

    Attributes:
        climb: The climb that does not exist.
        new_hold: What a new hold is like, apart from its place.
        rng: Source of random numbers.
        seconds: Time to spend [s].
    """

    climb: RelaxedClimb
    new_hold: Hold
    rng: np.random.Generator
    seconds: float
    _until: float = field(init=False)

    def find(self, frontier: Frontier, target: Target, places: bool = True) -> Changes:
        """Changes that make a climb, looked for between a frontier and the target it falls short of.

        Args:
            frontier: How far one gets.
            target: What is not reached.
            places: Whether to look for places for one hold more.
        """
        began = clock.perf_counter()
        self._until = began + self.seconds / 2
        friction = self._friction(frontier)
        if not places:
            return friction
        self._until = began + self.seconds
        good, tried = self._one_hold(frontier, target)
        return replace(friction, holds=tuple(good), places_tried=tried)

    def _moves(self, wall: Wall) -> int | None:
        """Fewest moves on a changed wall; None if there is no climb, or what is proved impossible leaves none."""
        climb = self.climb.on(wall)
        try:
            graph = climb.graph()
        except ClimberError:  # the start itself fails
            return None
        if climb.reached(graph).moves is None:
            return None
        return climb.reached(graph, climb.impossible(graph)).moves

    def _late(self) -> bool:
        return clock.perf_counter() > self._until

    # --- friction ----------------------------------------------------------------------------------------------------

    def _friction(self, frontier: Frontier) -> Changes:
        wall = self.climb.wall
        # A pin that is strong enough can do whatever any friction can, and more.
        strong = STRONG * self.climb.robot.mass * 9.81
        pins = tuple(replace(hold, grip="pin", max_force=strong, max_moment=strong) for hold in wall.holds)
        if self._moves(replace(wall, holds=pins)) is None:
            return Changes(forces_matter=False)
        useful = tuple(number for number, hold in enumerate(wall.holds) if hold.grip != "pin")
        tests = [useful, *((hold,) for hold in self._by_nearness(useful, frontier))] if useful else []
        found, tried = [], 0
        for holds in tests:
            if self._late():
                break
            tried += 1
            moves = self._moves(more_friction(wall, holds))
            if moves is not None:
                found.append(Change("friction", moves, holds))
        return Changes(friction=tuple(found), friction_tried=tried, friction_all_tried=tried == len(tests))

    def _by_nearness(self, holds: tuple[int, ...], frontier: Frontier) -> list[int]:
        positions = self.climb.wall.positions[:, :2]
        middle = positions[list(frontier.stances[0].holds)].mean(axis=0)
        return sorted(holds, key=lambda hold: (float(np.linalg.norm(positions[hold] - middle)), hold))

    # --- one hold more -----------------------------------------------------------------------------------------------

    def _one_hold(self, frontier: Frontier, target: Target) -> tuple[list[Change], int]:
        wall, number = self.climb.wall, len(self.climb.wall.holds)
        good, tried = [], 0
        for place in self._places(frontier, target):
            if self._late():
                break
            tried += 1
            hold = replace(self.new_hold, position=(float(place[0]), float(place[1]), self._height(place)))
            moves = self._moves(replace(wall, holds=(*wall.holds, hold)))
            if moves is not None:
                good.append(Change("hold", moves, (number,), hold))
        return sorted(good, key=lambda change: change.moves), tried

    def _height(self, place: Vector) -> float:
        """How far out of the wall plane a hold at a place would stick, which is as far as the one nearest to it [m]."""
        positions = self.climb.wall.positions
        return float(positions[np.linalg.norm(positions[:, :2] - place, axis=1).argmin(), 2])

    def _places(self, frontier: Frontier, target: Target) -> Iterator[Vector]:
        """Places spread evenly over the gap from the frontier to the target, on no other hold and in no obstacle."""
        wall, reach = self.climb.wall, float(np.mean(self.climb.robot.reach))
        holds = [*frontier.stances[0].holds, *target.demanded]
        gap = MultiPoint(wall.positions[holds, :2])
        if target.region is not None:
            gap = gap.union(target.region if isinstance(target.region, BaseGeometry) else target.region.outline())
        area = gap.convex_hull.buffer(reach / 2)
        x0, y0, x1, y1 = area.bounds
        halton = qmc.Halton(2, rng=self.rng)
        given = 0
        for _ in range(8 * PLACES):
            place = np.array([x0, y0]) + halton.random(1)[0] * np.array([x1 - x0, y1 - y0])
            apart = np.linalg.norm(wall.positions[:, :2] - place, axis=1)
            widths = np.array([hold.half_width for hold in wall.holds]) + self.new_hold.half_width
            free = (apart > np.maximum(widths, 1e-3)).all() and shapely.contains_xy(area, *place)
            free &= not any(obstacle.intersects(Point(*place)) for obstacle in wall.obstacles)
            if free and not any(rock.distance(np.append(place, self._height(place))) == 0.0 for rock in wall.rock):
                yield np.round(place, 4)
                given += 1
                if given == PLACES:
                    return
