"""What can be drawn on: an SVG document (`climber.svg`) or a smoothed image (`climber.raster`), by the same calls.

Whatever is drawn on one can be drawn on the other, so the pictures and the animation share their drawing code. Both
take pixels, x to the right and y down from the upper left corner; a `View` turns metres of the wall plane into pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from climber.stance import Vector

Anchor = Literal["start", "middle", "end"]

HALO = "#ffffff"


@dataclass(frozen=True)
class View:
    """Where a point of the wall plane appears on a canvas: equal scale along x and y, y upwards.

    Attributes:
        lower: Lower left corner of what is seen, in W's x-y plane [m].
        upper: Upper right corner [m].
        left: Abscissa of the lower left corner on the canvas [px].
        bottom: Ordinate of the lower left corner on the canvas [px].
        scale: Pixels per metre.
    """

    lower: tuple[float, float]
    upper: tuple[float, float]
    left: float
    bottom: float
    scale: float

    def __call__(self, points: ArrayLike) -> Vector:
        """Pixels of points of W [m], shape (..., 2 or 3), seen from the climber's side; shape (..., 2)."""
        xy = np.asarray(points, dtype=float)[..., :2]
        scale = np.array([self.scale, -self.scale])
        result: Vector = np.array([self.left, self.bottom]) + scale * (xy - np.array(self.lower))
        return result

    @property
    def width(self) -> float:
        """Width of what is seen [px]."""
        return self.scale * (self.upper[0] - self.lower[0])

    @property
    def height(self) -> float:
        """Height of what is seen [px]."""
        return self.scale * (self.upper[1] - self.lower[1])


class Canvas(Protocol):
    """What can be drawn on. Points have shape (n, 2) and are in pixels, as are widths and sizes."""

    def polygon(
        self, points: ArrayLike, fill: str | None, alpha: float = 1.0, stroke: str | None = None, width: float = 1.0
    ) -> None:
        """A closed polygon; `alpha` applies to the fill."""

    def line(
        self, points: ArrayLike, color: str, width: float = 1.0, alpha: float = 1.0, dash: float | None = None
    ) -> None:
        """A polyline with round joints and ends; `dash` is the length of its dashes and of the gaps between them."""

    def disk(
        self,
        center: ArrayLike,
        radius: float,
        fill: str | None,
        alpha: float = 1.0,
        stroke: str | None = None,
        width: float = 1.0,
    ) -> None:
        """A circle; `alpha` applies to the fill."""

    def text(
        self,
        at: ArrayLike,
        text: str,
        size: float,
        color: str,
        anchor: Anchor = "middle",
        bold: bool = False,
        halo: bool = False,
    ) -> None:
        """One line of text, vertically centred on `at`; with a halo it can be read on any ground."""

    def group(self, title: str) -> AbstractContextManager[None]:
        """What is drawn inside belongs together and is called `title`."""

    def save(self, path: str | Path) -> None:
        """Writes the picture, whole or not at all."""


def dashes(points: ArrayLike, length: float) -> Sequence[Vector]:
    """The dashes of a polyline, with gaps as long as themselves between them.

    Args:
        points: Corners of the polyline, shape (n, 2).
        length: Length of a dash [unit of the points].

    Returns:
        The corners of each dash, each of shape (m, 2).
    """
    corners = np.asarray(points, dtype=float)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    pieces = []
    for begin in np.arange(0.0, along[-1], 2.0 * length):
        end = min(begin + length, along[-1])
        inside = along[(along > begin) & (along < end)]
        stations = np.concatenate([[begin], inside, [end]])
        pieces.append(np.column_stack([np.interp(stations, along, corners[:, axis]) for axis in (0, 1)]))
    return pieces
