"""Contact forces near wished ones that make a motion within friction and torques, quick enough for a controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from climber.definite import solved
from climber.stance import Vector
from climber.wall import Wall

LEAST = 0.05  # a foot presses on its hold at least so hard [N]
FULL = 0.995  # share of a friction cone that may be used, if it must
LIGHT = 0.1  # least readiness of a light foot to press harder, beside one with its share of the load
FEEBLE = 0.05  # share of the mean push below which a foot's friction becomes no dearer
SMOOTH = 0.05  # friction below which forces across the normal become no harder to change
# What it costs to be one newton beyond a limit, where one newton along a normal off the wished force costs 1: the share
# of friction that is to be used, the balance, and what holds and motors can do.
SPARED, BALANCE, LIMIT = 1e3, 1e8, 1e11
LEVELS = (1.0, 0.5, 0.2)  # of the friction to be spared, and of the push: beyond each it costs `DEARER` more
DEARER = 10.0
LEVELLED = np.array([*LEVELS, 0.0])  # and of neither, which is as dear as any limit
INSIDE = 1e-4  # [N, N m] a limit that is exceeded by less is kept
STEPS = 30  # of Newton's method at the most
FEW = 6  # steps from the solution of the moment before; two or three are taken
GENTLER = (1e2, 1e4, 1e6, 1e8, 1e10)  # greatest weights of programs on the way to a solution from afar
SETTLED = 1e-4  # [N, N m] a step that is shorter ends it
SHORTEST = 1e-3  # share of a step that is taken even if it does not help
ROUNDING = 1e-12  # share of the cost
LEVEL = 1e-6  # share of the slope that a step begins with, at which it ends level
TINY = 1e-9  # [N]


@dataclass(frozen=True)
class Demand:
    """What m forces and moments x are to do: feet one after another, and then grippers.

    Attributes:
        wished: Those that are wished for [N, N m], shape (m,).
        E: What they do to the robot where it has no motors, shape (rows, m).
        load: What they have to do there [N, N m], shape (rows,).
        A: What they spare the motors, shape (motors, m): torques are c - A x.
        c: Torques without them [N m], shape (motors,).
        most: What the motors can [N m], shape (motors,).
        drop: Share of friction that is to be left unused.
        press: How hard each foot is to press at least, if it can [N].
        turn: Angle by which forces are to stay inside friction cones at least [rad].
    """

    wished: Vector
    E: Vector
    load: Vector
    A: Vector
    c: Vector
    most: Vector
    drop: float
    press: float
    turn: float = 0.0


class ForceControl:
    """Chooses the forces of feet on given holds, and the moments on grippers.

    Given wished forces x*, a load b and torques tau = c - A x,

        min   |x - x*|^2_R + S sum_k sum_c ( r_k^2 (t_k - (1 - c d) mu_k n_k)_+^2 + (c press - n_k)_+^2 )
              + B |E x - b|^2
              + L ( sum_k (t_k - mu_k n_k)_+^2 + sum_k (least - n_k)_+^2 + sum_j (|tau_j| - tau_max,j)_+^2 )

    where n_k is the part of the force of foot k along its hold's normal, with a magnet's adhesion, and t_k the length
    of the part across. R makes forces along normals easier to change than those across, by the square of the friction,
    and those of light feet hard to change. L >> B >> S >> R is an order of precedence: what holds and motors cannot do
    is not asked for; the robot is carried as it should be if that can be done; the share d of friction is left unused
    if that can be; and what freedom remains goes to the wished forces. The cones are the exact, second-order ones. As
    everything is a penalty there always is a solution, which exceeds a limit by its multiplier over its weight: less
    than a millinewton for what cannot be done, if forces within the limits exist.

    Where forces are to stay inside the cones by an angle, d is for each foot the share that this comes to, or the given
    one if that is more. The sum over c is over `LEVELS`, with S `DEARER` from one to the next, and r_k is how much less
    than the mean of all feet foot k pressed the moment before, 1 if it pressed more: friction that is to be spared and
    cannot be is taken from all feet, and from a light one, which soon slips, even less than its share.

    The program is convex, has a continuous gradient, and is quadratic but for the cones. Newton's method with the
    second derivatives of what is exceeded (semismooth, Qi and Sun 1993) and the best share of each step takes two or
    three steps from the forces of the moment before; from afar it goes by way of smaller weights. Where the closed form
    for R alone, with E x = b, exceeds nothing, it is the solution.
    """

    def __init__(self, wall: Wall, holds: Sequence[int], axes: int, moments: int) -> None:
        """Reads off the cones.

        Args:
            wall: The wall.
            holds: The hold of each foot.
            axes: Components of a foot's force, 2 or 3.
            moments: How many of the grips take a moment; these come last in the forces, in the order of `holds`.
        """
        grips = [wall.holds[number] for number in holds]
        size = axes * len(holds) + moments
        self._rubs = [k for k, hold in enumerate(grips) if hold.grip != "pin"]
        friction = np.array([grips[k].friction for k in self._rubs])
        # Shares of friction that may be used, by level and foot, are the first less what is to be left of the second.
        self._friction = np.array([*np.ones_like(LEVELS), FULL])[:, None] * friction
        self._spared = LEVELLED[:, None] * friction
        self._rough = np.maximum(friction, TINY)
        costs = [*(SPARED * DEARER**level for level in range(len(LEVELS))), LIMIT]
        self._costs = np.array([costs, costs])[:, :, None] * np.ones(len(friction))  # of cones, of pushes; by foot
        self._pull = np.array([grips[k].adhesion for k in self._rubs])
        self._turn, ease = np.eye(size), np.ones(size)  # the axes of holds, the normal last
        self._places = np.array([range(axes * k, axes * k + axes) for k in self._rubs], dtype=int).reshape(-1, axes)
        for k, places in zip(self._rubs, self._places, strict=True):
            frame = [wall.tangents[holds[k]], wall.binormals[holds[k]], wall.normals[holds[k]]]
            self._turn[np.ix_(places, places)] = np.array(frame if axes == 3 else frame[::2])[:, :axes]
            ease[places[:-1]] = 0.5 * min(max(grips[k].friction, SMOOTH), 1.0) ** 2
        turned = [hold for hold in grips if hold.max_moment > 0.0]
        ease[axes * len(holds) :] = [(hold.max_moment / hold.max_force) ** 2 for hold in turned]
        self._ease = ease
        self._across, self._along = self._places[:, :-1], self._places[:, -1]
        self._normals = np.eye(size)[self._places[:, -1]]
        self._moment = np.array([hold.max_moment for hold in turned])
        self._gripping = np.eye(size)[axes * len(holds) :]
        self._last: Vector | None = None  # forces of the moment before
        self.steps = 0

    def forces(self, demand: Demand) -> Vector:
        """The forces, foot after foot, and then the moments [N, N m], shape (m,)."""
        program = _Program(self, demand)
        x = program.balanced()
        if program.exceeds(x):
            x = program.solve(x, self._last)
        self._last = x
        result: Vector = self._turn.T @ x
        return result

    def cost(self, demand: Demand, forces: Vector) -> float:
        """The objective at given forces, shape (m,)."""
        return _Program(self, demand).point(self._turn @ forces).cost


class _Point(NamedTuple):
    """Forces, and what the program says of them.

    Attributes:
        x: The forces, shape (m,).
        excess: By how much each limit is exceeded, shape (c,).
        turning: Signs of the torques.
        along: Which way each foot's force across the normal points, shape (k, axes - 1).
        slide: Its length, shape (k,).
        pulls: Derivatives of the penalties by their limits, halved, shape (c,).
        smooth: Half the gradient of all else, shape (m,).
        cost: The objective.
    """

    x: Vector
    excess: Vector
    turning: Vector
    along: Vector
    slide: Vector
    pulls: Vector
    smooth: Vector
    cost: float


class _Program:
    """The program of one moment, in the axes of holds."""

    def __init__(self, control: ForceControl, demand: Demand) -> None:
        self._control = control
        back = control._turn.T
        self._wished, self._E, self._b = control._turn @ demand.wished, demand.E @ back, demand.load
        self._A, self._c, self._most = demand.A @ back, demand.c, demand.most
        if len(control._moment):
            self._A = np.concatenate([self._A, control._gripping])
            self._c, self._most = np.append(self._c, 0.0 * control._moment), np.append(self._most, control._moment)
        self._presses = np.maximum(demand.press * LEVELLED, LEAST)[:, None]
        inside = np.tan(np.maximum(np.arctan(control._rough) - demand.turn, 0.0)) / control._rough
        self._shares = control._friction - np.maximum(demand.drop, 1.0 - inside) * control._spared  # (levels, feet)
        self._ease = control._ease * self._readiness() ** 2

    @cached_property
    def _weights(self) -> Vector:
        """What it costs to be beyond each limit, shape (c,)."""
        control = self._control
        last = self._wished if control._last is None else control._last
        pushes = np.maximum(last[control._along] + control._pull, TINY)
        mean = sum(pushes.tolist()) / max(len(pushes), 1)
        costs = control._costs.copy()
        costs[0, :-1] *= np.minimum(np.maximum(mean / pushes, 1.0), 1.0 / FEEBLE) ** 2
        return np.concatenate([costs.ravel(), np.full(len(self._most), LIMIT)])

    def _readiness(self) -> Vector:
        """How readily each force changes, shape (m,): a foot that hardly presses has no friction to spare."""
        control, ready = self._control, np.ones(len(self._wished))
        pushes = self._wished[control._along] + control._pull
        mean = max(sum(pushes.tolist()) / max(len(pushes), 1), LEAST)
        ready[control._places] = np.minimum(np.maximum(pushes / mean, LIGHT), 1.0)[:, None]
        return ready

    def balanced(self) -> Vector:
        """The solution but for what is exceeded."""
        eased = self._ease[:, None] * self._E.T
        carry = self._E @ eased
        diagonal = carry.reshape(-1)[:: len(carry) + 1]
        diagonal += 1e-9 * sum(diagonal.tolist()) + 1e-12
        result: Vector = self._wished + eased @ solved(carry, self._b - self._E @ self._wished)
        return result

    def _limits(self, x: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        """The `excess`, the `torque`, the forces `across` normals, shape (k, axes - 1), and their lengths, `slide`."""
        across, push = x[self._control._across], x[self._control._along] + self._control._pull
        slide = np.sqrt(np.add.reduce(across * across, axis=1) + TINY**2)
        torque = self._c - self._A @ x
        cones = slide - self._shares * push
        excess = np.concatenate([cones.ravel(), (self._presses - push).ravel(), np.abs(torque) - self._most])
        return excess, torque, across, slide

    def exceeds(self, x: Vector) -> bool:
        """Whether forces use more friction than they should, or a foot or motor does what it cannot."""
        worst: float = max(self._limits(x)[0].tolist())
        return worst > INSIDE

    def point(self, x: Vector) -> _Point:
        """What there is to say of forces."""
        excess, torque, across, slide = self._limits(x)
        off, lacking, beyond = x - self._wished, self._E @ x - self._b, np.maximum(excess, 0.0)
        eased, pulls = off / self._ease, self._weights * beyond
        cost = float(eased @ off + BALANCE * lacking @ lacking + pulls @ beyond)
        smooth = eased + BALANCE * lacking @ self._E
        return _Point(x, excess, np.sign(torque), across / slide[:, None], slide, pulls, smooth, cost)

    def _slopes(self, point: _Point) -> Vector:
        """How limits change with the forces, shape (c, m)."""
        across, normals = self._control._across, self._control._normals
        cones = -self._shares[:, :, None] * normals
        cones[:, np.arange(len(across))[:, None], across] = point.along
        torques = -point.turning[:, None] * self._A
        pushes = np.tile(-normals, (len(LEVELLED), 1))
        return np.concatenate([cones.reshape(-1, len(point.x)), pushes, torques])

    def _curvature(self, point: _Point, slopes: Vector) -> Vector:
        """Half the Hessian, shape (m, m)."""
        tight, along = point.excess > 0.0, point.along
        slopes = slopes[tight]
        result = self._fixed + (slopes.T * self._weights[tight]) @ slopes
        if along.shape[1] > 1:  # on the wall plane cones are straight
            bent = np.add.reduce(point.pulls[: self._shares.size].reshape(self._shares.shape)) / point.slide
            turn = np.eye(along.shape[1]) - along[:, :, None] * along[:, None, :]
            across = self._control._across
            result[across[:, :, None], across[:, None, :]] += bent[:, None, None] * turn
        return np.asarray(result)

    @cached_property
    def _fixed(self) -> Vector:
        """The part of it that does not depend on the forces, shape (m, m)."""
        result: Vector = np.diag(1.0 / self._ease) + BALANCE * self._E.T @ self._E
        return result

    def solve(self, x: Vector, last: Vector | None) -> Vector:
        """The solution: from that of the moment before, or from x by way of programs with smaller weights."""
        if last is not None:
            found, settled = self._descend(last, FEW)
            if settled:
                return found
        weights = self._weights
        for most in GENTLER:
            self._weights = np.minimum(weights, most)
            x, _ = self._descend(x, STEPS)
        self._weights = weights
        return self._descend(x, STEPS)[0]

    def _descend(self, x: Vector, steps: int) -> tuple[Vector, bool]:
        """Newton's method from x with so many steps at the most; and whether that is the end."""
        point, kept = self.point(x), False
        for _ in range(steps):
            self._control.steps += 1
            slopes = self._slopes(point)
            step = -solved(self._curvature(point, slopes), point.smooth + point.pulls @ slopes)
            # A step may be short because of a limit that it is about to leave, but not after one that left none.
            short = max(map(abs, step.tolist())) < SETTLED
            if short and kept:
                return point.x + step, True
            share, before = self._best_share(point, slopes @ step, step), point
            while True:
                point = self.point(before.x + share * step)
                if share < SHORTEST or point.cost <= before.cost + ROUNDING * abs(before.cost):
                    break
                share *= 0.5
            kept = (before.excess > 0.0).tolist() == (point.excess > 0.0).tolist()
            if short and kept:
                return point.x, True
        return point.x, False

    def _best_share(self, point: _Point, change: Vector, step: Vector) -> float:
        """The share of a step that costs least, between 0 and 1, were the cones straight.

        The slope of the cost is then piecewise linear in the share: that of what is smooth, and for each limit
        w change (excess + share change)_+.

        Args:
            point: Where the step begins.
            change: How limits change in the whole step, shape (c,).
            step: The step, shape (m,).
        """
        carried, weighted = self._E @ step, self._weights * change
        slope, curvature = point.smooth @ step, (step / self._ease) @ step + BALANCE * carried @ carried

        def slopes(shares: Vector) -> Vector:
            beyond = np.maximum(point.excess + shares[:, None] * change, 0.0)
            return np.asarray(slope + shares * curvature + beyond @ weighted)

        start, end = slopes(np.array([0.0, 1.0]))
        if end <= LEVEL * abs(start):
            return 1.0
        crossing = change * point.excess < 0.0
        ends = -point.excess[crossing] / change[crossing]
        ends = np.concatenate([[0.0], np.sort(ends[ends < 1.0]), [1.0]])
        rising = slopes(ends)
        above = np.flatnonzero(rising > 0.0)
        if not len(above) or above[0] == 0:
            return 1.0
        k = above[0]
        part = rising[k - 1] / (rising[k - 1] - rising[k])
        return float(ends[k - 1] + part * (ends[k] - ends[k - 1]))
