"""An error of one kind at all samples of a phase: what they need then, and which forces will do.

Written for `verify_margins`, which says in what order forces are tried.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from climber.plan_parts import MarginKind, Phase
from climber.robot import Indices, Robot
from climber.stance import Vector
from climber.verify_mechanics import Mechanics
from climber.verify_motion import Motion
from climber.verify_rules import MARGIN
from climber.verify_survival import Give, Need
from climber.wall import Wall

SPARSE = 10  # a hold's place is tried at one sample in so many; between them forces are interpolated at first


@dataclass(frozen=True)
class Error:
    """An error to be survived: of friction; or along or about a direction in W; or of one of the phase's contacts."""

    kind: MarginKind
    size: float
    direction: Vector
    contact: int = -1


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


class PhaseNeeds:
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
        sparse = np.linspace(0, self.count - 1, 2 + self.count // SPARSE).astype(int)
        told = np.abs(phase.time - phase.margins["place"].time).argmin()  # the instant named as the worst
        self.knots = np.unique([*sparse, told])
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
                gives = tuple(give.turned(error.size) for give in gives)
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


class Trial:
    """One error at all samples of a phase.

    Attributes:
        left: Samples that no forces are known for yet, as places in the demand's rows.
        lacking: What is lacking at the worst sample known [N, N m].
        where: The time of that sample [s].
    """

    def __init__(self, phase: PhaseNeeds, number: int, error: Error) -> None:
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
