"""The fields of a scenario file, their defaults and meanings.

Holds are numbered by their place in the file, from 0. Lengths are in metres, angles in radians (degrees where a name
says so), forces in newtons, all in the wall frame W. A `rule` on a field says what it accepts beyond its type. Regions,
obstacles and facets are in `climber.scenario_shapes`.
"""

# Drake reads the types of the fields at run time, so this module cannot postpone its annotations.

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import field
from typing import cast

from climber.scenario_shapes import FacetSpec, RegionSpec
from climber.wall import GRIPS, Grip, Hold
from climber.yaml_tree import rule

# Share of the errors for which there are contact forces that is told as a margin: controllers need what is left.
KEPT = 0.95
SURE = 0.985  # margins are sought greater than asked for by this much, as they are found up to a hundredth


@dataclasses.dataclass
class HoldDefaults:
    """What a hold has when it does not say otherwise; the meanings are those of `climber.wall.Hold`.

    Attributes:
        half_width: Half the width of the patch, a disk across the normal [m].
        min_force: Least force along each edge of the friction cone while a foot holds on [N].
        max_force: Greatest force along each edge of the friction cone [N].
        friction: Coulomb coefficient.
        grip: friction, pin or magnet.
        adhesion: Pull of a magnet [N]; other grips have none.
        max_moment: Greatest moment between a pin and the gripper on it [N m]; other grips have none.
    """

    half_width: float = field(default=0.01, metadata=rule(at_least=0.0))
    min_force: float = field(default=0.5, metadata=rule(at_least=0.0))
    max_force: float = field(default=20.0, metadata=rule(above=0.0))
    friction: float = field(default=0.6, metadata=rule(at_least=0.0))
    grip: str = field(default="friction", metadata=rule(choices=GRIPS))
    adhesion: float = field(default=0.0, metadata=rule(at_least=0.0))
    max_moment: float = field(default=0.0, metadata=rule(at_least=0.0))


@dataclasses.dataclass
class HoldSpec:
    """A hold as surveyed. What is not given comes from the wall's `hold_defaults`.

    Attributes:
        position: Centre of the patch in W [m], (x, y) or (x, y, z); z is 0 if left out.
        normal: Outward normal of the patch in W, of any length but zero; z is 0 if left out.
        half_width: Half the width of the patch [m].
        min_force: Least force along each edge of the friction cone while a foot holds on [N].
        max_force: Greatest force along each edge of the friction cone [N].
        friction: Coulomb coefficient.
        grip: friction, pin or magnet.
        adhesion: Pull of a magnet [N].
        max_moment: Greatest moment between a pin and the gripper on it [N m].
    """

    position: list[float] = field(default_factory=list, metadata=rule(required=True, lengths=(2, 3)))
    normal: list[float] = field(default_factory=list, metadata=rule(required=True, lengths=(2, 3)))
    half_width: float | None = field(default=None, metadata=rule(at_least=0.0))
    min_force: float | None = field(default=None, metadata=rule(at_least=0.0))
    max_force: float | None = field(default=None, metadata=rule(above=0.0))
    friction: float | None = field(default=None, metadata=rule(at_least=0.0))
    grip: str | None = field(default=None, metadata=rule(choices=GRIPS))
    adhesion: float | None = field(default=None, metadata=rule(at_least=0.0))
    max_moment: float | None = field(default=None, metadata=rule(at_least=0.0))

    def build(self, defaults: HoldDefaults) -> Hold:
        """The hold, with `defaults` where it says nothing."""
        limits = {
            name: getattr(self, name) if getattr(self, name) is not None else default
            for name, default in dataclasses.asdict(defaults).items()
        }
        grip = cast(Grip, limits.pop("grip"))
        if grip != "magnet":
            limits["adhesion"] = 0.0
        if grip != "pin":
            limits["max_moment"] = 0.0
        x, y, z = [*self.position, 0.0][:3]
        length = math.hypot(*self.normal)
        nx, ny, nz = [*(component / length for component in self.normal), 0.0][:3]
        return Hold(position=(x, y, z), normal=(nx, ny, nz), grip=grip, **limits)


@dataclasses.dataclass
class WallSpec:
    """The wall.

    Attributes:
        inclination_deg: 90 is vertical, less is a slab, more an overhang; 0 is a floor, without gravity in its plane
            [degrees].
        hold_defaults: What holds have in common.
        holds: The holds, numbered from 0 in this order.
        obstacles: Regions that no part of a robot may touch.
        facets: The pieces of the wall's surface, which robots in space keep in front of. A planar robot is taken to
            move in front of them all.
    """

    inclination_deg: float = field(default=90.0, metadata=rule(at_least=0.0, below=180.0))
    hold_defaults: HoldDefaults = field(default_factory=HoldDefaults)
    holds: list[HoldSpec] = field(default_factory=list, metadata=rule(required=True, empty=False))
    obstacles: list[RegionSpec] = field(default_factory=list)
    facets: list[FacetSpec] = field(default_factory=list)


@dataclasses.dataclass
class Place:
    """Where a robot is to be: its goal, or a waypoint. At least one demand is given, and all that are must hold.

    Attributes:
        name: What a waypoint is called in plans and pictures.
        holds: The holds stood on, whichever limb is on which; as many as the robot has limbs.
        stance: The hold of every limb, by limb name.
        pelvis: The region that the pelvis's origin comes to rest in.
    """

    name: str = ""
    holds: list[int] | None = field(default=None, metadata=rule(at_least=0, empty=False))
    stance: dict[str, int] | None = field(default=None, metadata=rule(at_least=0, empty=False))
    pelvis: RegionSpec | None = None


@dataclasses.dataclass
class AvoidSpec:
    """What a robot must keep off.

    Attributes:
        holds: Holds that no limb may stand on.
        regions: Regions that no part of the robot may enter.
    """

    holds: list[int] = field(default_factory=list, metadata=rule(at_least=0))
    regions: list[RegionSpec] = field(default_factory=list)


@dataclasses.dataclass
class RobotSpec:
    """A robot, where it starts and where it must go.

    Attributes:
        name: Its name in plans and pictures, of letters, digits, `_` and `-`; no two robots share one.
        model: URDF or SDF file, `package://climber/...` or a path from the scenario's folder.
        start: The hold of every limb at the start, by limb name.
        start_posture: Joint angles at the start by joint name [rad], met within 0.001 rad, since written angles are
            rounded and feet are not to leave their holds; joints that are not named may be anywhere.
        goal: Where it must end.
        waypoints: Where it must have been, at rest, on the way.
        waypoint_order: "any" visits the waypoints in the order that is best, "given" in the order of the list.
        avoid: What it must keep off.
    """

    name: str = field(default="robot", metadata=rule(empty=False))
    model: str = field(default="", metadata=rule(required=True, empty=False))
    start: dict[str, int] = field(default_factory=dict, metadata=rule(required=True, at_least=0, empty=False))
    start_posture: dict[str, float] = field(default_factory=dict)
    goal: Place = field(default_factory=Place, metadata=rule(required=True))
    waypoints: list[Place] = field(default_factory=list)
    waypoint_order: str = field(default="any", metadata=rule(choices=("any", "given")))
    avoid: AvoidSpec = field(default_factory=AvoidSpec)


@dataclasses.dataclass
class CostWeights:
    """Weights of the three costs of a move, W1, W2 and W3 of Gönen eq. 4.22.

    Attributes:
        reach: W1, on the distance that the moving limb travels (4.19) [1/m].
        stability: W2, on one over the width of the support of the limbs that stay (4.20) [m].
        robustness: W3, on one over the area where the body can be during the move (4.21) [m^2].
    """

    reach: float = field(default=100.0, metadata=rule(at_least=0.0))
    stability: float = field(default=1.0, metadata=rule(at_least=0.0))
    robustness: float = field(default=1.0, metadata=rule(at_least=0.0))


@dataclasses.dataclass
class Budget:
    """What planning may spend before it answers "out of budget", which is never the same as "impossible".

    Attributes:
        time_limit_s: Wall-clock time for the whole plan [s].
        replans: How often the task planner may be asked again after a move was cut.
        posture_samples: Pelvis poses drawn at most while looking for one posture.
        postures: Candidate postures kept for each instant at which contacts change.
        path_attempts: Pairs of postures tried for one phase before its move is given up.
        path_iterations: Extensions of a path-search tree before a pair of postures is given up.
        improve_rounds: How often a better motion is looked for once there is one; the same rounds find the same.
        improve_s: Time for further rounds after those [s]; what they find depends on the machine.
        sample_rate_hz: Samples per second in the plan [1/s].
        longest_phase_s: A motion that its torques do not permit is slowed, but not beyond this duration [s].
        jerk_limit: Greatest jerk of joints [rad/s^3], and of the pelvis as it turns; of its place as much at the reach
            of a limb. 1000 lets joints reach their full acceleration in some 50 ms.
    """

    time_limit_s: float = field(default=120.0, metadata=rule(above=0.0))
    replans: int = field(default=200, metadata=rule(at_least=0))
    posture_samples: int = field(default=20_000, metadata=rule(at_least=1))
    postures: int = field(default=24, metadata=rule(at_least=1))
    path_attempts: int = field(default=12, metadata=rule(at_least=1))
    path_iterations: int = field(default=100, metadata=rule(at_least=1))
    improve_rounds: int = field(default=0, metadata=rule(at_least=0))
    improve_s: float = field(default=0.0, metadata=rule(at_least=0.0))
    sample_rate_hz: float = field(default=100.0, metadata=rule(at_least=100.0, at_most=10_000.0))
    longest_phase_s: float = field(default=30.0, metadata=rule(above=0.0))
    jerk_limit: float = field(default=1000.0, metadata=rule(above=0.0))


@dataclasses.dataclass
class MinMargin:
    """Margins that every phase of a plan must have, see docs/plan-format.md; zero asks for nothing.

    Attributes:
        friction: Share by which friction may be less.
        push: Force on the pelvis at the centre of mass, in any direction [N].
        mass: Share by which all masses may be off, up or down.
        center: Displacement of the centre of mass, in any direction [m].
        place: Displacement of any one hold [m].
        normal: Angle by which the normals of all holds may be turned, each its own way [rad].
    """

    friction: float = field(default=0.0, metadata=rule(at_least=0.0, at_most=0.9))
    push: float = field(default=0.0, metadata=rule(at_least=0.0, at_most=900.0))
    mass: float = field(default=0.0, metadata=rule(at_least=0.0, at_most=0.65))
    center: float = field(default=0.0, metadata=rule(at_least=0.0, at_most=0.018))
    place: float = field(default=0.0, metadata=rule(at_least=0.0, at_most=0.018))
    normal: float = field(default=0.0, metadata=rule(at_least=0.0, at_most=0.18))

    @property
    def drop(self) -> float:
        """The share by which friction is less on the wall that is planned on."""
        return self.friction / SURE / KEPT

    def raised(self, others: Mapping[str, float]) -> "MinMargin":
        """The greater of these margins and others by name."""
        return MinMargin(**{name: max(value, others.get(name, 0.0)) for name, value in vars(self).items()})


@dataclasses.dataclass
class ScenarioFields:
    """The fields of a scenario file.

    Attributes:
        name: What it is called; the file's stem unless the file says otherwise.
        description: A sentence or two for people.
        seed: Of all random numbers; the same seed gives the same plan.
        wall: The wall.
        robots: The robots.
        cost: Weights of the costs.
        budget: What planning may spend.
        objective: What is to be little along the climb, of those with the fewest moves at the least cost: "length" in
            joint space, "time", or "margin", the nearness to falling and to the motors' limits.
        min_margin: What every phase must survive.
        on_failure: What a motion that failed means to the task planner: "refine" bars its move from the piece of the
            stance's postures it was tried from, "cut" deletes the move, "penalise" makes it dearer.
    """

    name: str = ""
    description: str = ""
    seed: int = field(default=0, metadata=rule(at_least=0))
    wall: WallSpec = field(default_factory=WallSpec, metadata=rule(required=True))
    robots: list[RobotSpec] = field(default_factory=list, metadata=rule(required=True, empty=False))
    cost: CostWeights = field(default_factory=CostWeights)
    budget: Budget = field(default_factory=Budget)
    objective: str = field(default="length", metadata=rule(choices=("length", "time", "margin")))
    min_margin: MinMargin = field(default_factory=MinMargin)
    on_failure: str = field(default="refine", metadata=rule(choices=("refine", "cut", "penalise")))
