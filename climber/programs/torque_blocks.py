"""The programs of `climber.programs.torque` for many instants in one call of the solver.

Each function is one of the stages of `TorqueProgram`, with the instants as the blocks of one block-diagonal program.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from climber.programs.blocks import solve_blocks, solve_each
from climber.programs.instants import Instants
from climber.stance import Vector

TOLERANCE = 1e-6  # [N, N m] a violation below this is the solver's rounding
ROOM = 1.0  # [N, N m] the most room inside the limits that is looked for


class Least(NamedTuple):
    """Forces that violate limits the least, at each of K instants.

    Attributes:
        t: The forces, shape (K, n).
        s: The violation [N, N m], shape (K,); infinite where the solver finds no forces.
        y: Multipliers of E t = b, shape (K, u).
        w: Multipliers of the torques' limits, positive for the upper and negative for the lower, shape (K, j).
    """

    t: Vector
    s: Vector
    y: Vector
    w: Vector


def unlimited(instants: Instants) -> Vector:
    """The optimum without limits on forces and torques, shape (K, n): t = H^-1 (E^T y - g) with E t = b.

    Where no t has E t = b, one with the least |E t - b|.
    """
    H, g = instants.objective()
    solved = np.linalg.solve(H, np.concatenate([np.swapaxes(instants.E, 1, 2), -g[:, :, None]], axis=2))
    along, start = solved[:, :, :-1], solved[:, :, -1]  # H^-1 E^T and -H^-1 g
    gap = instants.b - np.einsum("sun,sn->su", instants.E, start)
    y = np.einsum("suw,sw->su", np.linalg.pinv(instants.E @ along, hermitian=True), gap)
    return instants.balanced(start + np.einsum("snu,su->sn", along, y))


def optimum(instants: Instants, unlimited: Vector) -> Vector | None:
    """The optimum within all limits, shape (K, n); None if an instant is infeasible.

    Args:
        instants: The instants.
        unlimited: Their optimum without limits, shape (K, n). The program is about the difference d from it, whose
            cost is d^T H d / 2: the solver then does not measure its accuracy against a large constant.
    """
    H, _ = instants.objective()
    rows, limits = _all_limits(instants)
    C, d = instants.force_cones()
    room = limits - np.einsum("srn,sn->sr", rows, unlimited)
    cone_room = d - np.einsum("scan,sn->sca", C, unlimited)
    change = solve_blocks(H, np.zeros_like(unlimited), instants.E, np.zeros_like(instants.b), rows, room, C, cone_room)
    return None if change is None else instants.balanced(unlimited + change.x)


def least_violation(instants: Instants) -> Least:
    """Balancing forces farthest inside all limits, or least outside: t (K, n) and s (K,) [N, N m], negative inside."""
    rows, limits = _all_limits(instants)
    t, s, y, z = _least_slack(instants, _slackened(rows, 1.0), limits, -ROOM)
    limited = np.flatnonzero(np.isfinite(instants.limit))
    upper, lower = np.split(z[:, z.shape[1] - 2 * len(limited) :], 2, axis=1)
    w = np.zeros(instants.c.shape)
    w[:, limited] = upper - lower
    return Least(t, s, -y, w)


def least_cone_violation(instants: Instants) -> tuple[Vector, Vector]:
    """Balancing forces with the least s_f, whatever the torques: t (K, n) and s_f (K,) [N]."""
    rows, limits = instants.force_limits()
    return _least_slack(instants, _slackened(rows, 1.0), limits, 0.0)[:2]


def least_torque_violation(instants: Instants) -> tuple[Vector, Vector]:
    """Balancing forces inside their limits with the least s_tau: t (K, n) and s_tau (K,) [N m]."""
    (forces, force_limits), (torques, torque_limits) = instants.force_limits(), instants.torque_limits()
    rows = np.concatenate([_slackened(forces, 0.0), _slackened(torques, 1.0)], axis=1)
    limits = np.concatenate([force_limits + TOLERANCE, torque_limits], axis=1)
    return _least_slack(instants, rows, limits, 0.0, cones_give=False)[:2]


def _all_limits(instants: Instants) -> tuple[Vector, Vector]:
    """Matrix (K, r, n) and right side (K, r) of the linear limits of forces and torques."""
    (forces, force_limits), (torques, torque_limits) = instants.force_limits(), instants.torque_limits()
    return np.concatenate([forces, torques], axis=1), np.concatenate([force_limits, torque_limits], axis=1)


def _slackened(rows: Vector, slack: float) -> Vector:
    """Rows with a column for the slack s after the others, so that rows t <= limits + slack s."""
    return np.concatenate([rows, np.full((*rows.shape[:2], 1), -slack)], axis=2)


def _least_slack(
    instants: Instants, rows: Vector, limits: Vector, lowest: float, cones_give: bool = True
) -> tuple[Vector, Vector, Vector, Vector]:
    """The least s >= lowest with E t = b and rows (t, s) <= limits, a conic program.

    Returns t, shape (K, n), s, (K,), and multipliers of the equations and of the rows.

    The apexes of friction cones give way by s too, or else by no more than rounding. Where the solver finds no forces
    they count as infinitely far outside: forces that no solver finds are of no use.
    """
    K, n = len(instants), len(instants.lower)
    cost, bound = np.zeros((K, n + 1)), np.zeros((K, 1, n + 1))
    cost[:, n], bound[:, 0, n] = 1.0, -1.0
    rows = np.concatenate([rows, bound], axis=1)
    limits = np.concatenate([limits, np.full((K, 1), -lowest)], axis=1)
    cones, tops = instants.force_cones()
    C, d = np.concatenate([cones, np.zeros((*cones.shape[:3], 1))], axis=3), tops.copy()
    if cones_give:
        C[:, :, 0, n] = -1.0
    else:
        d[:, :, 0] += TOLERANCE
    x, y, z = solve_each(cost, _slackened(instants.E, 0.0), instants.b, rows, limits, C, d)
    t, s = x[:, :n], x[:, n]
    return np.nan_to_num(t), np.where(np.isnan(s), np.inf, s), y, z[:, :-1]
