"""The circle across a friction cone, and the polygons that stand for it where programs must be linear."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from climber.stance import Vector

Kind = Literal["exact", "inscribed", "circumscribed"]
LEAST_EDGES = 3


@dataclass(frozen=True)
class Section:
    """What stands for the circle |u| <= 1 across a friction cone.

    Attributes:
        kind: "exact" is the circle. "inscribed" is a regular polygon with its corners on the circle, "circumscribed"
            one with its sides on it: cones become pyramids and second-order programs linear ones.
        edges: How many edges the pyramid has; 0 for the circle.
    """

    kind: Kind = "exact"
    edges: int = 0

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise ValueError(f"no section of a friction cone is called {self.kind!r}; there are {get_args(Kind)}")
        if (self.kind == "exact") != (self.edges == 0) or 0 < self.edges < LEAST_EDGES:
            raise ValueError(f"{self.kind} section with {self.edges} edges; a pyramid has at least {LEAST_EDGES}")

    @classmethod
    def parse(cls, name: str) -> Section:
        """The section of a name: "exact", "inscribed 8", "circumscribed 16"."""
        kind, _, edges = name.partition(" ")
        if edges and not edges.isdecimal():
            raise ValueError(f"{name!r} is no section of a friction cone; these are: 'exact', 'inscribed 8'")
        return cls(kind, int(edges or 0))  # type: ignore[arg-type]

    @property
    def name(self) -> str:
        """Its name, which `parse` reads."""
        return f"{self.kind} {self.edges}" if self.edges else self.kind

    @property
    def conservative(self) -> bool:
        """Whether every force it allows is within Coulomb friction; a circumscribed pyramid allows some that slip."""
        return self.kind != "circumscribed"

    @property
    def faithful(self) -> bool:
        """Whether it allows every force within Coulomb friction, so that what it rules out is impossible."""
        return self.kind != "inscribed"

    @property
    def radius(self) -> float:
        """How far its farthest point is from the middle."""
        return float(1.0 / np.cos(np.pi / self.edges)) if self.kind == "circumscribed" else 1.0

    @cached_property
    def sides(self) -> Vector:
        """Rows D with D u <= 1 for the polygon, shape (edges, 2)."""
        inner_radius = self.radius * np.cos(np.pi / max(self.edges, 1))
        sides: Vector = self._around(0.5 if self.kind == "inscribed" else 0.0) / inner_radius
        return sides

    @cached_property
    def corners(self) -> Vector:
        """The polygon's corners, shape (edges, 2); inscribed, the first is along e_1, else a side is across it."""
        return self.radius * self._around(0.0 if self.kind == "inscribed" else 0.5)

    def _around(self, first: float) -> Vector:
        """Unit vectors all around, the first at an angle of `first` of that between two, shape (edges, 2)."""
        angles = (np.arange(self.edges) + first) * 2 * np.pi / max(self.edges, 1)
        return np.column_stack([np.cos(angles), np.sin(angles)])

    def size(self, u: Vector) -> Vector:
        """How many times its own size it must be to hold u, shape (..., 2); shape (...)."""
        result: Vector = (u @ self.sides.T).max(axis=-1) if self.edges else np.hypot(u[..., 0], u[..., 1])
        return result

    def greatest(self, c: Vector) -> Vector:
        """The greatest c . u over it for c of shape (..., 2); shape (...)."""
        result: Vector = (c @ self.corners.T).max(axis=-1) if self.edges else np.hypot(c[..., 0], c[..., 1])
        return result


EXACT = Section()
