"""How fast can a robot run along a path? Time scaling as one conic program, contact forces included.

Drake's Toppra finds the fastest timing within torque and rate limits, but does not reason about contact forces. Here
the forces of the contacts are variables beside the speed, so that a timing comes with forces that the holds can give.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from climber.programs.path_dynamics import SLOWEST, Mask, PathDynamics
from climber.programs.sparse_program import Part, Rows, SparseProgram
from climber.programs.speed_profile import SpeedProfile
from climber.robot import Indices
from climber.stance import Vector

ROUNDS = 6  # after the first, at the most
GAIN = 0.02  # share of the duration: a round that gains less is the last one
AROUND = 2  # places next to one without enough force that get forces in the program too
ACTIVE = 1e-3  # share of a limit: less room than this, and a price on it of more than this, make it active


@dataclass(frozen=True)
class TimeScaling:
    """The fastest timing of a path.

    Attributes:
        coefficients: Of the speed profile, shape (profile.size,).
        duration: Time that the path takes [s].
        b: Squares of the speed at the places of the dynamics, shape (N,).
        a: Accelerations there, shape (N,).
        t: Multiples of the contacts' generators there [N], shape (N, n).
        active: At each place the limits that keep the motion from being faster, by name, N of them.
    """

    coefficients: Vector
    duration: float
    b: Vector
    a: Vector
    t: Vector
    active: tuple[frozenset[str], ...]

    @classmethod
    def steady(cls, dynamics: PathDynamics, profile: SpeedProfile, t: Vector) -> TimeScaling:
        """The timing with b = 1 everywhere, with given forces."""
        one = np.ones(len(dynamics.x))
        return cls(np.ones(profile.size), profile.length, one, 0.0 * one, t, (frozenset(),) * len(one))


class TimeScalingProgram:
    """The fastest timing of a path within the limits of contacts, motors and joints.

    Given a path q(x) with dynamics at places x_i (`PathDynamics`), nodes y_0 < ... < y_m on it, and b(x) = xdot^2 a
    B-spline with coefficients k (`SpeedProfile`), so that b and a = b'/2 are linear in k:

        min         sum_m T_m
        over        k, T_m, r_m, t_i
        subject to  (1) T_m (r_m + r_m+1) >= 2 (y_m+1 - y_m)           time from node to node
                    (2) r_m^2 <= b(y_m)                                speed at the nodes
                    (3) E t_i = e_0 + e_1 b_i + e_2 a_i                equations of motion without a motor
                    (4) |c_0 + c_1 b_i + c_2 a_i + d sqrt(b_i) - A t_i| <= torque limit
                    (5) rows t_i <= most_i                             edges of friction cones, force limits
                    (6) tops_i - cones t_i in the second-order cone    round friction cones
                    (7) b_i <= min_j (speed_j / |q'_ij|)^2             speed limits
                        b_i <= min_j (jerk_j / |q^(3)_ij|)^(2/3)       jerk limits at ends where q' = q'' = 0
                    (8) |q'_i a_i + q''_i b_i| <= acceleration limit
                    (9) |change of q' a + q'' b from i to i+1| <= jerk limit * (x_i+1 - x_i) / sqrt(mean of b_i, b_i+1)
                   (10) k >= 0, so that b >= 0 everywhere
                   (11) k = 0 at both ends, if the motion must be at rest there

    (1) and (2) are rotated second-order cones: for a piecewise linear b the sum is the motion's time exactly
    (Verscheure et al. 2009, eq. 23). Torques are eliminated in (4), so that (3) and (4) are the whole of the dynamics.

    (9) is not convex. But 1/sqrt(b) is a convex function of b, so that its tangent at any b' > 0 lies below it, and
    with the tangent in its place (9) is a linear constraint that implies the true one. The same goes for d sqrt(b) in
    (4), whose tangent lies above it, and which is at least zero. So every solution is feasible whatever b' is; solved
    again with b' the solution before, it gets no slower.

    Where the path can be stood on at every place, strictly within all limits, a timing exists: a slow enough one. So
    when there is none, a place at which the robot cannot even stand still is the reason (`climber.fastest.standing`).

    Most motions are slow: limits of speed, acceleration and jerk bind, and forces could make them many times as fast.
    Then forces that are known to hold the robot still, changed as little as balances its motion, make it. Where they
    do, the program has no forces and none of (3) to (6); it is solved again with forces where they do not.

    Attributes:
        dynamics: The path.
        profile: The B-splines that b is taken from.
        constraints: Names of the constraints and the rows that they are.
    """

    def __init__(
        self,
        dynamics: PathDynamics,
        profile: SpeedProfile,
        nodes: Vector | None = None,
        *,
        rest: bool = False,
        forces: Vector | None = None,
    ) -> None:
        """Builds the program, but for what depends on b'.

        Args:
            dynamics: The path.
            profile: The B-splines.
            nodes: The nodes y; by default the places of the dynamics.
            rest: Whether b must vanish at both ends. Along a path with q' = 0 at its ends it need not, see
                `climber.fastest`.
            forces: Multiples that hold the robot still at each place, shape (N, n), so that the program need not have
                forces where it does not take others; by default it has them everywhere.
        """
        self.dynamics, self.profile = dynamics, profile
        self._nodes = dynamics.x if nodes is None else nodes
        self._local, self._at_nodes = profile.local(dynamics.x), profile.local(self._nodes)
        self._N, self._n = len(dynamics.x), dynamics.E.shape[2]
        self._rest, self._standing = rest, forces
        # Of the limits that may be left out those that are not, by motor or by coordinate.
        motors, limited = dynamics.A.shape[1], dynamics.first.shape[1]
        self._told = {"torque": np.zeros(motors, bool), "acceleration": np.zeros(limited, bool), "jerk": dynamics.jerky}
        self._build(np.full(self._N, forces is None))

    def _build(self, placed: Mask) -> None:
        """The program with forces at some places, shape (N,), but for what depends on b'."""
        self._places = np.flatnonzero(placed)
        self._slot = np.cumsum(placed) - 1  # of each place among those
        steps = len(self._nodes) - 1
        # Variables: k, then T, r, t.
        self._T = self.profile.size
        self._r = self._T + steps
        self._t = self._r + steps + 1
        self.num_variables = self._t + len(self._places) * self._n
        self.constraints: dict[str, slice] = {}
        self._cost = np.zeros(self.num_variables)
        self._cost[self._T : self._r] = 1.0
        self._program = SparseProgram(self._cost)
        self._equal, self._below, self._round = Rows(), Rows(), Rows()
        self._balance()
        self._forces()
        self._speeds()
        self._time()

    # -- what rows are made of

    def _of_speed(self, i: Indices, of_b: Vector, of_a: Vector) -> Part:
        """of_b * b_i + of_a * a_i, each of shape (M,)."""
        local = self._local[i]
        return local.columns, local.combined(of_b, of_a)

    def _of_force(self, i: Indices, values: Vector) -> Part:
        """The sums values . t_i, i of shape (M,), values of shape (M, n)."""
        return self._t + self._n * self._slot[i][:, None] + np.arange(self._n), values

    def _each(self, width: int) -> tuple[Indices, Indices]:
        """Place and column of each entry of an array (N, width), at places with forces."""
        i, j = np.divmod(np.arange(len(self._places) * width), max(width, 1))
        return self._places[i], j

    @staticmethod
    def _both(places: Indices, limited: Mask) -> tuple[Vector, Indices, Indices]:
        """Sign, place and column of each of the limits either way of the limited columns at some places."""
        columns = np.flatnonzero(limited)
        sign, i, j = np.meshgrid(np.array([1.0, -1.0]), places, columns, indexing="ij")
        return sign.ravel(), i.ravel(), j.ravel()

    # -- the constraints

    def _balance(self) -> None:
        dynamics = self.dynamics
        i, u = self._each(dynamics.E.shape[1])
        self.constraints["balance"] = self._equal.add(
            dynamics.e[0][i, u],
            self._of_force(i, dynamics.E[i, u]),
            self._of_speed(i, -dynamics.e[1][i, u], -dynamics.e[2][i, u]),
        )
        if self._rest:
            ends = np.array([[0], [self.profile.size - 1]])
            self.constraints["rest"] = self._equal.add(np.zeros(2), (ends, np.ones((2, 1))))

    def _forces(self) -> None:
        dynamics = self.dynamics
        i, r = self._each(len(dynamics.rows))
        self.constraints["force"] = self._below.add(dynamics.most[i, r], self._of_force(i, dynamics.rows[r]))
        i, s = self._each(len(dynamics.cones))
        i, s, axis = np.repeat(i, 3), np.repeat(s, 3), np.tile(np.arange(3), len(i))
        self.constraints["cone"] = self._round.add(
            dynamics.tops[i, s, axis], self._of_force(i, dynamics.cones[s, axis])
        )

    def _speeds(self) -> None:
        every = np.arange(self._N)
        most, _ = self.dynamics.fastest
        self.constraints["speed"] = self._below.add(most, self._of_speed(every, np.ones(self._N), np.zeros(self._N)))
        size = self.profile.size
        self.constraints["positive"] = self._below.add(
            np.full(size, 0.0 if self._rest else -SLOWEST), (np.arange(size)[:, None], -np.ones((size, 1)))
        )

    def _accelerations(self) -> Rows:
        """(8)."""
        dynamics, rows = self.dynamics, Rows()
        sign, i, j = self._both(np.arange(self._N), self._told["acceleration"])
        rows.add(dynamics.acceleration[j], self._of_speed(i, sign * dynamics.second[i, j], sign * dynamics.first[i, j]))
        return rows

    def _time(self) -> None:
        nodes, local = self._nodes, self._at_nodes
        m, one = np.arange(len(nodes))[:, None], np.ones((len(nodes), 1))
        # (b + 1, b - 1, 2 r) is in the second-order cone.
        speed = local.columns, -local.b
        self.constraints["speed at the nodes"] = self._round.add_cones(
            (one[:, 0], (speed,)), (-one[:, 0], (speed,)), (0.0 * one[:, 0], ((self._r + m, -2.0 * one),))
        )
        # (T + r + r', T - r - r', 2 sqrt(2 dy)) is in the second-order cone.
        m, one = m[:-1], one[:-1]
        T, r, later = (self._T + m, -one), self._r + m, self._r + m + 1
        self.constraints["time from node to node"] = self._round.add_cones(
            (0.0 * one[:, 0], (T, (r, -one), (later, -one))),
            (0.0 * one[:, 0], (T, (r, one), (later, one))),
            (2.0 * np.sqrt(2.0 * np.diff(nodes)), ()),
        )

    def _torques(self, reference: Vector) -> Rows:
        """(4), its damping taken at the reference b' (N,)."""
        dynamics, rows = self.dynamics, Rows()
        sign, i, j = self._both(self._places, self._told["torque"])
        of_b, right = sign * dynamics.c[1][i, j], dynamics.torque[i, j] - sign * dynamics.c[0][i, j]
        if dynamics.damping is not None:  # sqrt(b) <= (sqrt(b') + b / sqrt(b')) / 2
            against, speed = np.maximum(sign * dynamics.damping[i, j], 0.0), np.sqrt(reference[i])
            of_b, right = of_b + 0.5 * against / speed, right - 0.5 * against * speed
        rows.add(
            right,
            self._of_force(i, -sign[:, None] * dynamics.A[i, j]),
            self._of_speed(i, of_b, sign * dynamics.c[2][i, j]),
        )
        return rows

    def _jerks(self, reference: Vector) -> Rows:
        """(9), its right side the tangent at the reference b' (N,)."""
        dynamics, rows = self.dynamics, Rows()
        sign, i, j = self._both(np.arange(self._N - 1), self._told["jerk"])
        mean = 0.5 * (reference[i] + reference[i + 1])
        most = dynamics.jerk[j] * np.diff(dynamics.x)[i] / np.sqrt(mean)
        half = 0.25 * most / mean  # for either b: the tangent is most (1.5 - 0.5 b / mean)
        rows.add(
            1.5 * most,
            self._of_speed(i + 1, sign * dynamics.second[i + 1, j] + half, sign * dynamics.first[i + 1, j]),
            self._of_speed(i, -sign * dynamics.second[i, j] + half, -sign * dynamics.first[i, j]),
        )
        return rows

    # -- solving

    def solve(self) -> TimeScaling | None:
        """The fastest timing, or None if Clarabel finds none.

        The first reference b' is one and a half times that of the paced motion, see `PathDynamics.paced`, the next ones
        the solution before, until they hardly gain any more.
        """
        reference = np.minimum(1.5 * self.dynamics.paced(), self.dynamics.fastest[0])
        best = self.solve_at(reference)
        while best is None and self.dynamics.damping is not None and reference.min() > SLOWEST:
            reference = reference / 16.0  # at so high a speed damping takes more torque than there is
            best = self.solve_at(reference)
        if self.dynamics.damping is None and not np.isfinite(self.dynamics.jerk).any():
            return best  # nothing depends on it
        for _ in range(ROUNDS):
            if best is None:
                break
            found = self.solve_at(np.maximum(best.b, SLOWEST))
            if found is None:
                break
            gained, best = 1.0 - found.duration / best.duration, found
            if gained < GAIN:
                break
        return best

    def solve_at(self, reference: Vector) -> TimeScaling | None:
        """The fastest timing for a reference b', shape (N,), positive; None if Clarabel finds none.

        Limits of torque, acceleration and jerk are left out, motor by motor and coordinate by coordinate, until a
        solution breaks them: one that keeps them without being told to is as good. So are forces, place by place.
        """
        placed = np.isin(np.arange(self._N), self._places)
        while True:
            solution = self._solved(reference)
            if solution is None and placed.all():
                return None
            lacking = ~placed
            if solution is not None:
                broken = {name: over & ~self._told[name] for name, over in self._broken(solution).items()}
                lacking &= ~self.dynamics.made(solution.t, solution.b, solution.a)
                if not lacking.any() and not any(over.any() for over in broken.values()):
                    return solution
                self._told = {name: told | broken[name] for name, told in self._told.items()}
            if lacking.any():  # what is next to them will lack forces soon
                placed |= np.convolve(lacking, np.ones(2 * AROUND + 1), mode="same") > 0.5
                self._build(placed)
            else:
                self._program = SparseProgram(self._cost)

    def _broken(self, scaling: TimeScaling) -> dict[str, Mask]:
        """The motors or coordinates whose limits a timing breaks, by kind of limit."""
        dynamics, b, a = self.dynamics, scaling.b[:, None], scaling.a[:, None]
        torque = dynamics.torques(scaling.t, scaling.b, scaling.a)
        acceleration = dynamics.second * b + dynamics.first * a
        steps = np.diff(dynamics.x) / np.sqrt(np.maximum(0.5 * (scaling.b[:-1] + scaling.b[1:]), SLOWEST))
        uses = {
            "torque": np.abs(torque) / dynamics.torque,
            "acceleration": np.abs(acceleration) / dynamics.acceleration,
            "jerk": np.abs(np.diff(acceleration, axis=0)) / steps[:, None] / dynamics.jerk,
        }
        return {name: use.max(axis=0, initial=0.0) > 1.0 for name, use in uses.items()}

    def _solved(self, reference: Vector) -> TimeScaling | None:
        """The solution with the limits that are told."""
        below = [self._below, self._accelerations(), self._torques(reference), self._jerks(reference)]
        found = self._program.solve(self._equal, below, self._round)
        return None if found is None else self._result(*found)

    def _result(self, x: Vector, prices: list[Vector]) -> TimeScaling:
        """The timing that is the solution x; prices are those of the rows that are not equations."""
        N, dynamics = self._N, self.dynamics
        coefficients, duration = x[: self.profile.size], float(x[self._T : self._r].sum())
        b, a = self._local.values(coefficients)
        active: list[set[str]] = [set() for _ in range(N)]
        dear = ACTIVE * duration / N

        def note(places: Indices, names: Sequence[str], price: Vector) -> None:
            """Prices of limits `names` at one place after the other."""
            for i, j in np.argwhere(price.reshape(-1, max(len(names), 1)) > dear):
                active[places[i]].add(names[j])

        forces, motors, coordinates = dynamics.names
        below, by_acceleration, by_torque, by_jerk, cones = prices
        every = np.arange(N)
        note(self._places, forces[: len(dynamics.rows)], below[self.constraints["force"]])
        note(self._places, forces[len(dynamics.rows) :], cones[self.constraints["cone"]][::3])
        for i in np.flatnonzero(below[self.constraints["speed"]] > dear):
            active[i].add(dynamics.fastest[1][i])
        for kind, places, names, price in (
            ("torque", self._places, motors, by_torque),
            ("acceleration", every, coordinates, by_acceleration),
            ("jerk", every, coordinates, by_jerk),
        ):
            limited = [f"{kind} {name}" for name, told in zip(names, self._told[kind], strict=True) if told]
            either = price[: 2 * (len(price) // 2)].reshape(2, -1)
            note(places, limited, either.max(axis=0, initial=0.0))
        t = np.zeros((N, self._n)) if self._standing is None else dynamics.lifted(self._standing, b, a)
        t[self._places] = x[self._t :].reshape(len(self._places), self._n)
        return TimeScaling(coefficients, duration, b, a, t, tuple(frozenset(names) for names in active))
