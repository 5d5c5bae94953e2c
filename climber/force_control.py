"""Contact forces near wished ones that make a motion within friction and torques, quick enough for a controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climber.stance import Vector
from climber.wall import Wall

LEAST = 0.05  # a foot presses on its hold at least so hard [N]
FULL = 0.995  # share of a friction cone that may be used, if it must
LIGHT = 0.1  # least readiness of a light foot to press harder, beside one with its share of the load
SMOOTH = 0.05  # friction below which forces across the normal become no harder to change
# What it costs to be one newton beyond a limit, where one newton along a normal off the wished force costs 1: the share
# of friction that is to be used, the balance, and what holds and motors can do.
SPARED, BALANCE, LIMIT = 1e4, 1e7, 1e10
LEVELS = (1.0, 0.5, 0.2)  # of the friction to be spared: beyond each it costs `DEARER` more, so that all feet share
DEARER = 10.0
INSIDE = 1e-4  # [N, N m] a limit that is exceeded by less is kept
STEPS = 12  # of Newton's method at the most
FEW = 6  # steps from the solution of the moment before; two or three are taken
GENTLER = (1e2, 1e4, 1e6, 1e8)  # greatest weights of programs on the way to a solution from afar
SETTLED = 1e-4  # [N, N m] a step that is shorter ends it
SHORTEST = 1e-3  # share of a step that is taken even if it does not help
ROUNDING = 1e-12  # share of the cost
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
    """

    wished: Vector
    E: Vector
    load: Vector
    A: Vector
    c: Vector
    most: Vector
    drop: float
    press: float


class ForceControl:
    """Chooses the forces of feet on given holds, and the moments on grippers.

    Given wished forces x*, a load b and torques tau = c - A x,

        min   |x - x*|^2_R + S sum_k ( sum_c (t_k - (1 - c d) mu_k n_k)_+^2 + (press - n_k)_+^2 ) + B |E x - b|^2
              + L ( sum_k (t_k - mu_k n_k)_+^2 + sum_k (least - n_k)_+^2 + sum_j (|tau_j| - tau_max,j)_+^2 )

    where n_k is the part of the force of foot k along its hold's normal, with a magnet's adhesion, and t_k the length
    of the part across. R makes forces along normals easier to change than those across, by the square of the friction,
    and those of light feet hard to change. L >> B >> S >> R is an order of precedence: what holds and motors cannot do
    is not asked for; the robot is carried as it should be if that can be done; the share d of friction is left unused
    if that can be; and what freedom remains goes to the wished forces. The cones are the exact, second-order ones. As
    everything is a penalty there always is a solution, which exceeds a limit by its multiplier over its weight: less
    than a millinewton for what cannot be done, if forces within the limits exist.

    The sum over c is over `LEVELS`, with S `DEARER` from one to the next: friction that is to be spared and cannot be
    is taken from all feet alike, not from a light one until it slips.

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
        self._friction = np.array([grips[k].friction for k in self._rubs])
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
        self._normals = np.eye(size)[self._places[:, -1]]
        self._moment = np.array([hold.max_moment for hold in turned])
        self._gripping = np.eye(size)[axes * len(holds) :]
        self._last: Vector | None = None
        self.steps = 0

    def forces(self, demand: Demand) -> Vector:
        """The forces, foot after foot, and then the moments [N, N m], shape (m,)."""
        program = _Program(self, demand)
        x = program.balanced()
        if program.exceeds(x):
            x = self._last = program.solve(x, self._last)
        else:
            self._last = None
        result: Vector = self._turn.T @ x
        return result

    def cost(self, demand: Demand, forces: Vector) -> float:
        """The objective at given forces, shape (m,)."""
        program, x = _Program(self, demand), self._turn @ forces
        return program.cost(x, program.limits(x)[0])


class _Program:
    """The program of one moment, in the axes of holds."""

    def __init__(self, control: ForceControl, demand: Demand) -> None:
        self._control = control
        back = control._turn.T
        self._wished, self._E, self._b = control._turn @ demand.wished, demand.E @ back, demand.load
        self._A = np.vstack([demand.A @ back, control._gripping])
        self._c = np.concatenate([demand.c, np.zeros(len(control._moment))])
        self._most = np.concatenate([demand.most, control._moment])
        self._press = max(demand.press, LEAST)
        shares = np.append(1.0 - demand.drop * np.array(LEVELS), FULL)
        self._shares = shares[:, None] * control._friction  # (levels, feet)
        k = len(control._friction)
        costs = np.append(SPARED * DEARER ** np.arange(len(LEVELS)), LIMIT)
        self._weights = np.concatenate([np.repeat(costs, k), np.full(k, SPARED), np.full(k + len(self._most), LIMIT)])
        self._ease = control._ease * self._readiness() ** 2

    def _readiness(self) -> Vector:
        """How readily each force changes, shape (m,): a foot that hardly presses has no friction to spare."""
        places, ready = self._control._places, np.ones(len(self._wished))
        pushes = self._wished[places[:, -1]] + self._control._pull
        mean = max(float(pushes.sum()) / max(len(pushes), 1), LEAST)
        ready[places] = np.clip(pushes / mean, LIGHT, 1.0)[:, None]
        return ready

    def balanced(self) -> Vector:
        """The solution but for what is exceeded."""
        eased = self._ease[:, None] * self._E.T
        carry = self._E @ eased
        carry += (1e-9 * np.trace(carry) + 1e-12) * np.eye(len(carry))
        result: Vector = self._wished + eased @ np.linalg.solve(carry, self._b - self._E @ self._wished)
        return result

    def _parts(self, x: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        """Forces across the normals, (k, axes - 1), their lengths, (k,), forces along, (k,), and torques."""
        feet = x[self._control._places]
        across = feet[:, :-1]
        return (
            across,
            np.sqrt((across**2).sum(axis=1) + TINY**2),
            feet[:, -1] + self._control._pull,
            self._c - self._A @ x,
        )

    def exceeds(self, x: Vector) -> bool:
        """Whether forces use more friction than they should, or a foot or motor does what it cannot."""
        return bool((self.limits(x)[0] > INSIDE).any())

    def limits(self, x: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        """By how much each limit is exceeded, (c,), the signs of torques, and slides as in `_parts`."""
        across, slide, push, torque = self._parts(x)
        excess = np.concatenate(
            [
                (slide - self._shares * push).ravel(),
                self._press - push,
                LEAST - push,
                np.abs(torque) - self._most,
            ]
        )
        return excess, np.sign(torque), across / slide[:, None], slide

    def _slopes(self, sign: Vector, along: Vector) -> Vector:
        """How limits change with the forces, shape (c, m)."""
        places, m = self._control._places, len(self._wished)
        slides = np.zeros((len(places), m))
        slides[np.arange(len(places))[:, None], places[:, :-1]] = along
        normals = self._control._normals
        cones = slides - self._shares[:, :, None] * normals
        return np.concatenate([cones.reshape(-1, m), -normals, -normals, -sign[:, None] * self._A])

    def cost(self, x: Vector, excess: Vector) -> float:
        """The objective at forces that exceed limits by so much."""
        off, lacking = x - self._wished, self._E @ x - self._b
        beyond = np.maximum(excess, 0.0)
        return float((off / self._ease) @ off + BALANCE * lacking @ lacking + (self._weights * beyond) @ beyond)

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
        places, cones = self._control._places, self._shares.size
        fixed = np.diag(1.0 / self._ease) + BALANCE * self._E.T @ self._E
        excess, sign, along, slide = self.limits(x)
        for _ in range(steps):
            self._control.steps += 1
            # Half the gradient and half the Hessian.
            slopes, beyond = self._slopes(sign, along), np.maximum(excess, 0.0)
            smooth = (x - self._wished) / self._ease + BALANCE * (self._E @ x - self._b) @ self._E
            gradient = smooth + (self._weights * beyond) @ slopes
            tight = slopes[excess > 0.0]
            hessian = fixed + (tight.T * self._weights[excess > 0.0]) @ tight
            bent = (self._weights * beyond)[:cones].reshape(self._shares.shape).sum(axis=0) / slide
            turn = np.eye(along.shape[1]) - along[:, :, None] * along[:, None, :]
            sideways = places[:, :-1]
            hessian[sideways[:, :, None], sideways[:, None, :]] += bent[:, None, None] * turn
            step = -np.linalg.solve(hessian, gradient)
            share = self._best_share(excess, slopes @ step, float(smooth @ step), float(step @ fixed @ step))
            cost, before = self.cost(x, excess), excess > 0.0
            while True:
                excess, sign, along, slide = self.limits(x + share * step)
                if share < SHORTEST or self.cost(x + share * step, excess) <= cost + ROUNDING * abs(cost):
                    break
                share *= 0.5
            x = x + share * step
            # A step may be short because of a limit that it is about to leave.
            if np.abs(step).max() < SETTLED and (before == (excess > 0.0)).all():
                return x, True
        return x, False

    def _best_share(self, excess: Vector, change: Vector, slope: float, curvature: float) -> float:
        """The share of a step that costs least, between 0 and 1, were the cones straight.

        The slope of the cost is slope + share curvature + sum w change (excess + share change)_+, piecewise linear.
        """

        def slopes(shares: Vector) -> Vector:
            beyond = np.maximum(excess + shares[:, None] * change, 0.0)
            return np.asarray(slope + shares * curvature + beyond @ (self._weights * change))

        crossing = change * excess < 0.0
        ends = np.append(-excess[crossing] / change[crossing], 1.0)
        ends = np.concatenate([[0.0], np.sort(ends[ends <= 1.0])])
        rising = slopes(ends)
        above = np.flatnonzero(rising > 0.0)
        if not len(above) or above[0] == 0:
            return 1.0
        k = above[0]
        part = rising[k - 1] / (rising[k - 1] - rising[k])
        return float(ends[k - 1] + part * (ends[k] - ends[k - 1]))
