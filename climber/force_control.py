"""Contact forces near wished ones that balance a load and stay in their cones, quick enough for a controller."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from climber.stance import Vector
from climber.wall import Wall

LEAST = 0.05  # a foot presses on its hold at least so hard [N]
SAFE = 0.98  # share of a friction cone that is used, unless the wished force uses more
LIGHT = 0.1  # least readiness of a light foot to press harder, beside one with its share of the load
ROUNDS = 4


class ForceControl:
    """Chooses the forces of feet on given holds, and the moments on grippers.

    Given wished forces lambda* and a load b, it seeks

        min   |lambda - lambda*|^2, weighted
        s.t.  (1) E lambda = b
              (2) n.f >= least, |f_t| <= mu n.f for a friction grip, f with the adhesion for a magnet

    by solving without (2), putting what leaves its cone on the border, and asking the other feet to make up for it, a
    few times over. What comes out is in the cones and need not be the optimum; (1) is met as nearly as that allows.
    Forces along normals are easier to change than those across, by the square of the friction.
    """

    def __init__(self, wall: Wall, holds: Sequence[int], axes: int, moments: int) -> None:
        """Reads off the cones.

        Args:
            wall: The wall.
            holds: The hold of each foot.
            axes: Components of a foot's force, 2 or 3.
            moments: How many of the grips take a moment; these come last in the forces, in the order of `holds`.
        """
        self._axes = axes
        self._grips = [(wall.holds[number], wall.normals[number][:axes]) for number in holds]
        self._ease = np.zeros((axes * len(holds) + moments,) * 2)
        for k, (hold, normal) in enumerate(self._grips):
            across = np.outer(normal, normal)
            sideways = 1.0 if hold.grip == "pin" else 0.5 * min(hold.friction, 1.0) ** 2
            mine = slice(axes * k, axes * k + axes)
            self._ease[mine, mine] = across + sideways * (np.eye(axes) - across)
        turned = [hold for hold, _ in self._grips if hold.max_moment > 0.0]
        for k, hold in enumerate(turned, start=axes * len(holds)):
            self._ease[k, k] = (hold.max_moment / hold.max_force) ** 2

    def forces(self, wished: Vector, E: Vector, load: Vector) -> Vector:
        """The forces, foot after foot, and then the moments [N, N m], shape (m,).

        Args:
            wished: Those that are wished for, shape (m,).
            E: What they do to the robot, shape (rows, m).
            load: What they have to do, shape (rows,).
        """
        ready, shares = self._readiness(wished), self._shares(wished)
        ease, forces = self._ease * np.outer(ready, ready), wished.copy()
        for _ in range(ROUNDS):
            carry = E @ ease @ E.T
            carry += (1e-9 * np.trace(carry) + 1e-12) * np.eye(len(carry))
            forces = forces + ease @ E.T @ np.linalg.solve(carry, load - E @ forces)
            outside, forces = self._inside(forces, shares)
            if not outside:
                break
            ease = ease.copy()
            for k in outside:
                ease[k] = ease[:, k] = 0.0
        return forces

    def _readiness(self, wished: Vector) -> Vector:
        """How readily each force changes, shape (m,): a foot that hardly presses has no friction to spare."""
        axes, result = self._axes, np.ones(len(wished))
        pushes = [
            float(n @ wished[axes * k : axes * k + axes]) + hold.adhesion for k, (hold, n) in enumerate(self._grips)
        ]
        mean = max(sum(pushes) / len(pushes), LEAST)
        for k, (hold, _) in enumerate(self._grips):
            if hold.grip != "pin":
                result[axes * k : axes * k + axes] = min(max(pushes[k] / mean, LIGHT), 1.0)
        return result

    def _shares(self, wished: Vector) -> list[float]:
        """The share of each foot's friction that may be used: what is wished for can be had."""
        result = []
        for k, (hold, normal) in enumerate(self._grips):
            total = wished[self._axes * k : self._axes * k + self._axes] + hold.adhesion * normal
            push = float(normal @ total)
            slide = float(np.sqrt(max(total @ total - push * push, 0.0)))
            used = slide / max(hold.friction * push, 1e-9) if hold.grip != "pin" and push > LEAST else 0.0
            result.append(min(max(SAFE, used), 1.0))
        return result

    def _inside(self, forces: Vector, shares: Sequence[float]) -> tuple[list[slice], Vector]:
        """Which feet's forces are outside their cones, and all forces with these moved to the border."""
        axes, moved = self._axes, []
        for k, (hold, normal) in enumerate(self._grips):
            if hold.grip == "pin":
                continue
            mine = slice(axes * k, axes * k + axes)
            total = forces[mine] + hold.adhesion * normal
            push = float(normal @ total)
            along = total - push * normal
            least = max(push, LEAST)
            most, slide = shares[k] * hold.friction * least, float(np.sqrt(along @ along))
            if push < least or slide > most:
                along = along * min(1.0, most / max(slide, 1e-12))
                forces = forces.copy()
                forces[mine] = least * normal + along - hold.adhesion * normal
                moved.append(mine)
        return moved, forces
