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
SPARED, BALANCE, LIMIT = 1e3, 1e5, 1e8
INSIDE = 1e-4  # [N, N m] a limit that is exceeded by less is kept
STEPS = 30  # of Newton's method at the most; two or three are taken
SETTLED = 1e-4  # [N, N m] a step that is shorter ends it
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

        min   |x - x*|^2_R + S sum_k ( (t_k - (1 - d) mu_k n_k)_+^2 + (press - n_k)_+^2 ) + B |E x - b|^2
              + L ( sum_k (t_k - mu_k n_k)_+^2 + sum_k (least - n_k)_+^2 + sum_j (|tau_j| - tau_max,j)_+^2 )

    where n_k is the part of the force of foot k along its hold's normal, with a magnet's adhesion, and t_k the length
    of the part across. R makes forces along normals easier to change than those across, by the square of the friction,
    and those of light feet hard to change. L >> B >> S >> R is an order of precedence: what holds and motors cannot do
    is not asked for; the robot is carried as it should be if that can be done; the share d of friction is left unused
    if that can be; and what freedom remains goes to the wished forces. The cones are the exact, second-order ones. As
    everything is a penalty there always is a solution, which exceeds a limit by its multiplier over its weight: less
    than a millinewton where forces within the limits exist.

    The program is convex, has a continuous gradient, and is quadratic but for the cones: Newton's method with the
    second derivatives of what is exceeded (semismooth, Qi and Sun 1993) and halved steps takes a few steps of the size
    of x, fewer from the forces of the moment before. Where the closed form for R alone, with E x = b, exceeds nothing,
    it is the solution.
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
        self._moment = np.array([hold.max_moment for hold in turned])
        self._gripping = np.eye(size)[axes * len(holds) :]
        self._last: Vector | None = None
        self.steps = 0

    def forces(self, demand: Demand) -> Vector:
        """The forces, foot after foot, and then the moments [N, N m], shape (m,)."""
        program = _Program(self, demand)
        x = program.balanced()
        if program.exceeds(x):
            x = program.solve(x if self._last is None else self._last)
            self._last = x
        else:
            self._last = None
        result: Vector = self._turn.T @ x
        return result


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
        self._spared, self._full = (1.0 - demand.drop) * control._friction, FULL * control._friction
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
        _, slide, push, torque = self._parts(x)
        return bool(
            (slide > self._spared * push + INSIDE).any()
            or (slide > self._full * push + INSIDE).any()
            or (push < self._press - INSIDE).any()
            or (np.abs(torque) > self._most + INSIDE).any()
        )

    def _cost(self, x: Vector) -> tuple[float, tuple[Vector, ...]]:
        """The objective, and what it is made of."""
        across, slide, push, torque = self._parts(x)
        spared, full = np.maximum(slide - self._spared * push, 0.0), np.maximum(slide - self._full * push, 0.0)
        least, over = np.maximum(LEAST - push, 0.0), np.maximum(np.abs(torque) - self._most, 0.0)
        light = np.maximum(self._press - push, 0.0)
        off, lacking = x - self._wished, self._E @ x - self._b
        cost = (off / self._ease) @ off + SPARED * (spared @ spared + light @ light) + BALANCE * lacking @ lacking
        cost += LIMIT * (full @ full + least @ least + over @ over)
        return float(cost), (across, slide, spared, full, light, least, np.copysign(over, torque), off, lacking)

    def solve(self, x: Vector) -> Vector:
        """Newton's method from x."""
        places, axes = self._control._places, self._control._places.shape[1]
        fixed = np.diag(1.0 / self._ease) + BALANCE * self._E.T @ self._E
        cost, parts = self._cost(x)
        for _ in range(STEPS):
            self._control.steps += 1
            across, slide, spared, full, light, least, over, off, lacking = parts
            # Half the gradient and half the Hessian.
            gradient = off / self._ease + BALANCE * lacking @ self._E - LIMIT * over @ self._A
            pull = SPARED * spared + LIMIT * full
            along = across / slide[:, None]
            gradient[places[:, :-1]] += pull[:, None] * along
            gradient[places[:, -1]] -= SPARED * (spared * self._spared + light) + LIMIT * (full * self._full + least)
            first, second = SPARED * (spared > 0.0), LIMIT * (full > 0.0)
            third = SPARED * (light > 0.0) + LIMIT * (least > 0.0)
            block = np.zeros((len(places), axes, axes))
            bent = pull / slide
            block[:, :-1, :-1] = (first + second - bent)[:, None, None] * along[:, :, None] * along[:, None, :]
            block[:, range(axes - 1), range(axes - 1)] += bent[:, None]
            mixed = (first * self._spared + second * self._full)[:, None] * along
            block[:, :-1, -1] = block[:, -1, :-1] = -mixed
            block[:, -1, -1] = first * self._spared**2 + second * self._full**2 + third
            hessian = fixed.copy()
            hessian[places[:, :, None], places[:, None, :]] += block
            tight = self._A[over != 0.0]
            if len(tight):
                hessian += LIMIT * tight.T @ tight
            step = -np.linalg.solve(hessian, gradient)
            if np.abs(step).max() < SETTLED:
                return np.asarray(x + step)
            slope, share = float(gradient @ step), 1.0
            while True:
                after, parts_after = self._cost(x + share * step)
                if after <= cost + 1e-4 * share * slope or share < 1e-3:
                    break
                share *= 0.5
            x, cost, parts = x + share * step, after, parts_after
        return x
