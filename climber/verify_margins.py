"""The checks of a robot's margins, by programs of their own on verify's own mechanics.

A margin says that the motion of a phase survives errors of one kind up to a size: at every sample there are contact
forces that balance the robot, keep to what the holds can then give, and need no torque beyond the motors' limits. The
claim is tried at every sample (a hold's place: at one in `SPARSE`) in directions all around: first with forces near
ones well inside the limits, then near forces found for other samples; where these will not do, a conic program
finds the least by which limits must be left. At the instant that the plan names as the worst, an error greater by a
share of `SHORT` must not be survived (in space with a little less friction), but for errors of a hold's place, of
which the plan gives a lower bound only.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from climber.plan_parts import MARGIN_KINDS, MarginKind, Phase, PhaseMargin, RobotPlan
from climber.robot import Indices, Robot
from climber.stance import Vector
from climber.verdict import Ledger
from climber.verify_model import Tree
from climber.verify_motion import Motion
from climber.verify_rules import MARGIN
from climber.verify_survival import Give, Need, shortages
from climber.wall import Wall

AROUND = 8  # directions in a plane
SHORT = {
    2: 0.03,
    3: 0.12,
}  # share by which a margin may be less than the greatest, for robots in the plane and in space
NARROW = 0.02  # share of friction that a planner may leave unused which fits pyramids into cones in space
SMALLEST = 1e-4  # and by this, in its own unit
UNSURVIVED = 1e-8  # [N, N m] what must be lacking at a greater error
SPARSE = 10
TIME = 1e-5  # [s] the same instant
STEP = 1e-5  # [m] of differences
EVERYWHERE = np.array(
    [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], dtype=float
)
EVERYWHERE /= np.linalg.norm(EVERYWHERE, axis=1, keepdims=True)
# Greater margins than these are given as these: shares, N, m, rad.
MOST: dict[MarginKind, float] = {
    "friction": 1.0,
    "push": 1000.0,
    "mass": 1.0,
    "center": 1.0,
    "place": 0.02,
    "normal": np.pi / 2,
}


@dataclass(frozen=True)
class Error:
    """An error to be survived: of friction; or along or about a direction in W; or of one of the phase's contacts."""

    kind: MarginKind
    size: float
    direction: Vector
    contact: int = -1


class Mechanics:
    """What the samples of a robot's whole plan need, and what errors add to it.

    Attributes:
        load: Generalised force without contacts [N, N m], shape (K, nv).
        columns: Generalised force of each foot's force in W, shape (K, num_limbs, nv, 3), to be added to the load.
        turns: Likewise of each foot's moment about z, shape (K, num_limbs, nv).
        heavier: What twice the masses add to the load, shape (K, nv).
        pushed: Generalised force of a force on the pelvis at the centre of mass, shape (K, nv, 3).
        displaced: What a centre of mass displaced by 1 m adds to the load, fixed to the pelvis, shape (K, nv, 3).
    """

    def __init__(self, robot: Robot, samples: Motion, gripped: bool) -> None:
        """Evaluates all; `gripped` says whether holds can turn feet at all."""
        self._robot, self._tree, self._samples, self.gravity = robot, Tree(robot), samples, robot.gravity
        self._dimension = 2 if robot.planar else 3
        tree, q, v, vd = self._tree, samples.q, samples.v, samples.vd
        poses, limbs = tree.poses(q), len(robot.limbs)
        none = np.zeros((len(q), limbs, 3))
        self.load = tree.required_force(poses, v, vd, none)
        self.columns = self._columns(tree, q, range(limbs))
        self.turns = np.zeros((len(q), limbs, v.shape[1]))
        for limb in range(limbs) if gripped else ():
            moment = np.zeros((len(q), limbs))
            moment[:, limb] = 1.0
            self.turns[:, limb] = tree.required_force(poses, v, vd, none, moment) - self.load
        self.heavier = tree.heavier(2.0).required_force(poses, v, vd, none) - self.load
        R = tree.pelvis_turned(poses)
        axes = np.eye(3)[: self._dimension]
        own = [tree.off_center(axis).required_force(poses, v, vd, none) - self.load for axis in axes]
        self.displaced = np.einsum("pkv,kwp->kvw", np.array(own), R[:, :, : self._dimension])
        out = np.einsum("kwp,kw->kp", R, tree.center_of_mass(poses) - tree.pelvis(poses))
        points = self._columns(tree.held_at(np.concatenate([np.zeros((1, 3)), axes])), q, range(1 + len(axes)))
        self.pushed = points[:, 0] + np.einsum("kp,kpvw->kvw", out[:, : len(axes)], points[:, 1:] - points[:, :1])

    def _columns(self, tree: Tree, q: Vector, limbs: range) -> Vector:
        """What forces of 1 N on the feet add to the required force, (K, len(limbs), nv, 3)."""
        poses, rest = tree.poses(q), np.zeros(q.shape)
        feet = tree.feet(poses).shape
        start = tree.required_force(poses, rest, rest, np.zeros(feet))
        result = np.zeros((len(q), len(limbs), q.shape[1], 3))
        for i, limb in enumerate(limbs):
            for axis in range(self._dimension):
                force = np.zeros(feet)
                force[:, limb, axis] = 1.0
                result[:, i, :, axis] = tree.required_force(poses, rest, rest, force) - start
        return result

    def followed(self, rows: Vector) -> tuple[Vector, Vector]:
        """First-order changes when a limb's foot is displaced, per metre along W's axes.

        The limb follows, the pelvis does not move, and only the limb's weight counts.

        Args:
            rows: Samples.

        Returns:
            Of the load, shape (K, num_limbs, nv, 3), and of the limb's own columns, shape (K, num_limbs, nv, 3, 3); the
            displacement last.
        """
        tree, q, limbs = self._tree, self._samples.q[rows], self._robot.limbs
        load = np.zeros((len(q), len(limbs), q.shape[1], 3))
        columns = np.zeros((len(q), len(limbs), q.shape[1], 3, 3))
        axes = slice(0, self._dimension)
        rest, none = np.zeros(q.shape), np.zeros((len(q), len(limbs), 3))
        for number, limb in enumerate(limbs):
            along = -self.columns[rows, number][:, limb.v, axes]  # the foot's velocity by the joints'
            inverse = np.linalg.pinv(np.swapaxes(along, 1, 2))
            for axis in range(self._dimension):
                ends = []
                for sign in (1.0, -1.0):
                    moved = q.copy()
                    moved[:, limb.q] += sign * STEP * inverse[:, :, axis]
                    own = self._columns(tree, moved, range(number, number + 1))[:, 0]
                    ends.append((tree.required_force(tree.poses(moved), rest, rest, none), own))
                load[:, number, :, axis] = (ends[0][0] - ends[1][0]) / (2.0 * STEP)
                columns[:, number, ..., axis] = (ends[0][1] - ends[1][1]) / (2.0 * STEP)
        return load, columns


@dataclass(frozen=True)
class Demand:
    """What an error makes of the needs of a phase's samples.

    Attributes:
        rows: The samples it is tried at, shape (K,).
        E: Shape (K, u, n).
        b: [N, N m], shape (K, u).
        A: Shape (K, j, n).
        c: [N m], shape (K, j).
        gives: What each contact's hold gives.
    """

    rows: Indices
    E: Vector
    b: Vector
    A: Vector
    c: Vector
    gives: tuple[Give, ...]


class _Needs:
    """What the samples of one phase need.

    Attributes:
        knots: Samples for which forces are sought to begin with, shape (N,).
        inner: Forces well inside the limits, shape (K, n).
    """

    def __init__(
        self, robot: Robot, wall: Wall, phase: Phase, span: slice, mechanics: Mechanics, samples: Motion
    ) -> None:
        self._mechanics, self._span, self._phase = mechanics, span, phase
        self._dimension = 2 if robot.planar else 3
        self._limbs = [robot.limb_names.index(contact.limb) for contact in phase.contacts]
        self.gives = tuple(Give.of(wall.holds[contact.hold], robot.planar) for contact in phase.contacts)
        self._turned = any(give.moment > 0.0 for give in self.gives)
        motors = np.flatnonzero(robot.effort > 0.0)
        self._driven = robot.joint_v[motors]
        self._free = np.setdiff1d(np.arange(samples.v.shape[1]), self._driven)
        self.effort = np.minimum(robot.effort[motors], 1e6)
        self._columns = self._placed(mechanics.columns[span][:, self._limbs])
        self.time, self.count = phase.time, len(phase.time)
        self.knots = np.unique(np.linspace(0, self.count - 1, 2 + self.count // SPARSE).astype(int))
        self.levers: tuple[Vector, Vector] = (np.zeros(0), np.zeros(0))
        self._inverse = np.linalg.pinv(self._columns[:, self._free])

    def _placed(self, columns: Vector) -> Vector:
        """What contact forces, and moments of pins, supply, shape (K, nv, n), from (K, k, nv, 3)."""
        own = -np.swapaxes(columns[..., : self._dimension], 1, 2)
        own = own.reshape(len(own), own.shape[1], -1)
        if not self._turned:
            return own
        return np.concatenate([own, -np.swapaxes(self._mechanics.turns[self._span][:, self._limbs], 1, 2)], axis=2)

    def demand(self, error: Error | None) -> Demand:
        """What an error makes of the needs."""
        mechanics, span, gives = self._mechanics, self._span, self.gives
        load, columns, rows = mechanics.load[span], self._columns, np.arange(self.count)
        if error is not None:
            step = error.size * error.direction
            if error.kind == "friction":
                gives = tuple(give.slippery(error.size) for give in gives)
            elif error.kind == "normal":
                turned = gives[error.contact].turned(error.direction, error.size)
                gives = tuple(turned if i == error.contact else give for i, give in enumerate(gives))
            elif error.kind == "mass":
                down = float(np.sign(error.direction @ mechanics.gravity))
                load = load + down * error.size * mechanics.heavier[span]
            elif error.kind == "push":
                load = load + mechanics.pushed[span] @ step
            elif error.kind == "center":
                load = load + mechanics.displaced[span] @ step
            else:
                rows = self.knots
                weight, lever = (part[:, self._limbs[error.contact]] for part in self.levers)
                load, columns = load[rows] + weight @ step, columns[rows].copy()
                own = slice(error.contact * self._dimension, (error.contact + 1) * self._dimension)
                columns[:, :, own] -= (lever @ step)[..., : self._dimension]
        free, driven = self._free, self._driven
        return Demand(rows, columns[:, free], load[:, free], columns[:, driven], load[:, driven], gives)

    def need(self, row: int, demand: Demand) -> Need:
        """The needs of one sample."""
        at = int(np.searchsorted(demand.rows, row))
        return Need(demand.E[at], demand.b[at], demand.A[at], demand.c[at], self.effort, demand.gives)

    def settle(self, forces: Vector) -> None:
        """Takes forces at the knots, shape (N, n)."""
        every = np.arange(self.count)
        self.inner = np.stack([np.interp(every, self.knots, column) for column in forces.T], axis=1)

    def excess(self, demand: Demand, x: Vector, at: Indices) -> Vector:
        """By how much the forces nearest to x, (K, n), that balance at places `at` leave limits or balance."""
        E, b = demand.E[at], demand.b[at]
        inverse = self._inverse[at] if len(demand.rows) == self.count else np.linalg.pinv(E)
        x = x + np.einsum("knu,ku->kn", inverse, b - np.einsum("kun,kn->ku", E, x))
        worst = np.abs(np.einsum("kun,kn->ku", E, x) - b).max(axis=1, initial=0.0)
        torque = demand.c[at] - np.einsum("kjn,kn->kj", demand.A[at], x)
        worst = np.maximum(worst, (np.abs(torque) - self.effort).max(axis=1, initial=-np.inf))
        forces, k = np.zeros((len(x), len(demand.gives), 3)), len(demand.gives)
        forces[:, :, : self._dimension] = x[:, : k * self._dimension].reshape(len(x), k, self._dimension)
        for i, give in enumerate(demand.gives):
            worst = np.maximum(worst, give.excess(forces[:, i]))
            if self._turned:
                worst = np.maximum(worst, np.abs(x[:, k * self._dimension + i]) - give.moment)
        return np.asarray(worst)


class _Trial:
    """One error at all samples of a phase.

    Attributes:
        left: Samples that no forces are known for yet, as places in the demand's rows.
        lacking: What is lacking at the worst sample known [N, N m].
        where: The time of that sample [s].
    """

    def __init__(self, phase: _Needs, number: int, error: Error) -> None:
        self.phase, self.number, self.error = phase, number, error
        self.demand = phase.demand(error)
        self.left = np.arange(len(self.demand.rows))
        self.lacking, self.where = -np.inf, phase.time[0]
        self._excess = np.full(len(self.left), np.inf)
        self._known: dict[int, Vector] = {}

    def attempt(self, x: Vector) -> None:
        """Tries the forces nearest to x, one for each sample of the phase, shape (count, n)."""
        excess = self.phase.excess(self.demand, x[self.demand.rows[self.left]], self.left)
        survived = excess <= 0.5 * MARGIN
        if survived.any():
            place = int(np.argmax(np.where(survived, excess, -np.inf)))
            self._note(int(self.left[place]), float(excess[place]))
        self.left, self._excess = self.left[~survived], excess[~survived]

    def _note(self, place: int, lacking: float) -> None:
        if lacking > self.lacking:
            self.lacking, self.where = lacking, float(self.phase.time[self.demand.rows[place]])

    def worst(self) -> int:
        """The sample whose program is to be solved next."""
        return int(self.demand.rows[self.left[int(np.argmax(self._excess))]])

    def learn(self, row: int, x: Vector, lacking: float) -> None:
        """Takes the outcome of the program of a sample."""
        place = int(np.searchsorted(self.demand.rows, row))
        self._note(place, lacking if np.isfinite(lacking) else np.inf)
        if self.lacking > MARGIN:  # refuted, wherever else
            self.left = self.left[:0]
            return
        self._excess = self._excess[self.left != place]
        self.left = self.left[self.left != place]
        if np.isfinite(x).all() and len(self.left):
            self._known[row] = x
            rows = sorted(self._known)
            known, every = np.array([self._known[r] for r in rows]), np.arange(self.phase.count)
            self.attempt(np.stack([np.interp(every, rows, column) for column in known.T], axis=1))


def _samples(phase: Phase, margin: PhaseMargin) -> NDArray[np.bool_]:
    """Which of a phase's samples a margin names as the worst, shape (N,)."""
    return np.asarray(np.abs(phase.time - margin.time) <= TIME)


def _in_parts(needs: list[Need], dimension: int) -> tuple[list[Vector], Vector]:
    """`shortages`, a few hundred at a time."""
    parts = [shortages(needs[i : i + 300], dimension) for i in range(0, len(needs), 300)]
    return [x for forces, _ in parts for x in forces], np.concatenate([np.zeros(0), *(lacking for _, lacking in parts)])


class MarginChecks:
    """Goes through the margins of a robot's phases and takes down what it finds."""

    def __init__(self, robot: Robot, wall: Wall, asked: Mapping[str, float], plan: RobotPlan, ledger: Ledger) -> None:
        self._robot, self._wall, self._plan, self._ledger, self._asked = robot, wall, plan, ledger, asked
        self._planar = robot.planar
        self._dimension = 2 if robot.planar else 3
        samples = [Motion.samples(phase, plan, robot) for phase in plan.phases]
        ends = np.cumsum([0, *(len(motion.time) for motion in samples)])
        self._spans = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        whole = Motion(*(np.concatenate([vars(motion)[name] for motion in samples]) for name in vars(samples[0])))
        self._time, self._mechanics = whole.time, Mechanics(robot, whole, any(hold.max_moment for hold in wall.holds))
        self._phases = [
            _Needs(robot, wall, phase, span, self._mechanics, whole)
            for phase, span in zip(plan.phases, self._spans, strict=True)
        ]

    def check(self) -> None:
        """Checks every margin of every phase."""
        for number, phase in enumerate(self._plan.phases):
            for kind in MARGIN_KINDS:
                if asked := self._asked[kind]:
                    short = np.array([1.0 - phase.margins[kind].value / asked])
                    self._ledger.note("asked margins", short, [self._label(number, kind)])
        self._ledger.faults("worst instants", [fault for n in range(len(self._plan.phases)) for fault in self._odd(n)])
        self._settle()
        knots = np.concatenate(
            [needs.knots + span.start for needs, span in zip(self._phases, self._spans, strict=True)]
        )
        followed = self._mechanics.followed(knots)
        for needs, span in zip(self._phases, self._spans, strict=True):
            mine = (span.start <= knots) & (knots < span.stop)
            needs.levers = followed[0][mine], followed[1][mine]
        trials = [
            _Trial(needs, number, error) for number, needs in enumerate(self._phases) for error in self._errors(number)
        ]
        self._survive(trials)
        self._tight()

    def _label(self, number: int, kind: str) -> str:
        return f"{self._plan.name}, phase {number} ({self._plan.phases[number].label}), {kind}"

    def _odd(self, number: int) -> Iterator[str]:
        """What is written down of a margin must have a meaning."""
        phase = self._plan.phases[number]
        limbs = {contact.limb for contact in phase.contacts}
        for kind in MARGIN_KINDS:
            margin, at = phase.margins[kind], self._label(number, kind)
            if not np.any(_samples(phase, margin)):
                yield f"{at}: t = {margin.time:.4f} s is no sample of the phase"
            if margin.value > MOST[kind]:
                yield f"{at}: {margin.value:g} is greater than {MOST[kind]:g}, beyond which margins are not told"
            if self._open(kind, margin):
                continue
            if (margin.limb is not None) != (kind in ("place", "normal")) or margin.limb not in {None, *limbs}:
                yield f"{at}: {margin.limb or 'no limb'} is named as the limb of the hold"
            length = 0.0 if margin.direction is None else float(np.linalg.norm(margin.direction))
            if abs(length - (kind != "friction")) > 1e-6:
                yield f"{at}: a unit direction is expected" if kind != "friction" else f"{at}: it has no direction"

    def _open(self, kind: MarginKind, margin: PhaseMargin) -> bool:
        """Whether a margin is as great as they come, so that nothing is known of a worst case."""
        return margin.value * (1.0 + SHORT[self._dimension]) + SMALLEST >= MOST[kind]

    def _errors(self, number: int) -> Iterator[Error]:
        """The errors that a phase claims to survive."""
        phase = self._plan.phases[number]
        gravity = self._wall.gravity / np.linalg.norm(self._wall.gravity)
        around = self._around(np.array([0.0, 0.0, 1.0])) if self._planar else EVERYWHERE
        for kind in MARGIN_KINDS:
            size = phase.margins[kind].value
            if size == 0.0:  # nothing is claimed
                continue
            if kind == "friction":
                yield Error(kind, size, np.zeros(3))
            elif kind == "mass":
                yield from (Error(kind, size, sign * gravity) for sign in (1.0, -1.0))
            elif kind in ("push", "center"):
                named = phase.margins[kind].direction
                told = [] if named is None else [np.array(named) / max(float(np.linalg.norm(named)), 1e-9)]
                yield from (Error(kind, size, direction) for direction in [*around, *told])
            else:
                for i, contact in enumerate(phase.contacts):
                    normal = self._wall.normals[contact.hold]
                    axes = self._around(normal) if kind == "normal" else around
                    if kind == "normal" and self._planar:
                        axes = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
                    yield from (Error(kind, size, axis, i) for axis in axes)

    def _around(self, normal: Vector) -> Vector:
        """Unit vectors across `normal`, and for robots in space along it if it is z, shape (D, 3)."""
        across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        across /= np.linalg.norm(across)
        angle = 2.0 * np.pi * (np.arange(AROUND) + 0.5) / AROUND
        return np.asarray(np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(normal, across))

    def _settle(self) -> None:
        """Finds forces well inside the limits at some samples of each phase, and between them by interpolation."""
        needs, owners = [], []
        for phase in self._phases:
            for row in phase.knots:
                needs.append(phase.need(int(row), phase.demand(None)))
                owners.append(phase)
        forces, _ = _in_parts(needs, self._dimension)
        for phase in self._phases:
            phase.settle(np.array([x for x, owner in zip(forces, owners, strict=True) if owner is phase]))

    def _survive(self, trials: list[_Trial]) -> None:
        """Tries all errors at all samples, programs for those at which none of the forces known will do."""
        for trial in trials:
            trial.attempt(trial.phase.inner)
        while open_trials := [trial for trial in trials if len(trial.left)]:
            rows = [trial.worst() for trial in open_trials]
            needs = [trial.phase.need(row, trial.demand) for trial, row in zip(open_trials, rows, strict=True)]
            for trial, row, x, lacking in zip(open_trials, rows, *_in_parts(needs, self._dimension), strict=True):
                trial.learn(row, x, float(lacking))
        for trial in trials:
            at = self._label(trial.number, trial.error.kind)
            self._ledger.note("margins", np.array([trial.lacking]), [f"{at}, t = {trial.where:.4f} s"])

    def _tight(self) -> None:
        """At the worst instant a greater error is not survived."""
        needs, labels = [], []
        for number, phase in enumerate(self._plan.phases):
            for kind in MARGIN_KINDS:
                margin = phase.margins[kind]
                rows = np.flatnonzero(_samples(phase, margin))
                if kind == "place" or self._open(kind, margin) or not len(rows):
                    continue
                names = [contact.limb for contact in phase.contacts]
                contact = names.index(margin.limb) if margin.limb in names else -1
                direction = np.zeros(3) if margin.direction is None else np.array(margin.direction)
                size = margin.value * (1.0 + SHORT[self._dimension]) + SMALLEST
                demand = self._phases[number].demand(Error(kind, size, direction, contact))
                if not self._planar:
                    demand = replace(demand, gives=tuple(give.slippery(NARROW) for give in demand.gives))
                needs.append(self._phases[number].need(int(rows[0]), demand))
                labels.append(f"{self._label(number, kind)}: {size:.4g} is survived at t = {margin.time:.4f} s")
        _, lacking = _in_parts(needs, self._dimension)
        self._ledger.faults(
            "worst instants", [label for label, s in zip(labels, lacking, strict=True) if not s > UNSURVIVED]
        )
