"""Legends: a sign and a word for each thing a picture shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from climber.canvas import Canvas, View
from climber.picture import CONES, INK, OBSTACLE, ROCK_EDGE, paint_center_of_mass, paint_hold_shape
from climber.stance import Vector
from climber.wall import Hold, Wall

Sign = Callable[[Canvas, Vector], None]  # draws itself at a pixel, about 18 px wide and 12 px tall
Entry = tuple[Sign, str]

SIZE = 12.0  # of the letters [px]
WORD = np.array([18.0, 0.0])  # from a sign to its word [px]


def box(color: str, alpha: float = 1.0, stroke: str | None = None) -> Sign:
    """A rectangle."""
    corners = np.array([[-9.0, -6.0], [9.0, -6.0], [9.0, 6.0], [-9.0, 6.0]])
    return lambda canvas, at: canvas.polygon(at + corners, color, alpha, stroke=stroke, width=1.2)


def bar(color: str, width: float) -> Sign:
    """A short line."""
    return lambda canvas, at: canvas.line(at + np.array([[-8.0, 0.0], [8.0, 0.0]]), color, width)


def ring(color: str, width: float = 2.5) -> Sign:
    """A circle."""
    return lambda canvas, at: canvas.disk(at, 6.0, None, stroke=color, width=width)


def cross(color: str) -> Sign:
    """A cross."""

    def paint(canvas: Canvas, at: Vector) -> None:
        for slope in (-1.0, 1.0):
            canvas.line(at + 5.0 * np.array([[-1.0, -slope], [1.0, slope]]), color, 2.5)

    return paint


def both(first: Sign, second: Sign) -> Sign:
    """One sign over another."""

    def paint(canvas: Canvas, at: Vector) -> None:
        first(canvas, at)
        second(canvas, at)

    return paint


def center_of_mass() -> Sign:
    """The quartered disk."""

    def paint(canvas: Canvas, at: Vector) -> None:
        paint_center_of_mass(canvas, View((0.0, 0.0), (0.0, 0.0), at[0], at[1], 1.0), np.zeros(2), 6.0)

    return paint


def hold(like: Hold) -> Sign:
    """A hold of the same grip and friction, upright."""
    upright = Hold((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), like.friction, 0.01, grip=like.grip)

    def paint(canvas: Canvas, at: Vector) -> None:
        view = View((0.0, 0.0), (0.0, 0.0), at[0], at[1] + 4.0, 270.0)
        paint_hold_shape(canvas, view, upright, np.array([1.0, 0.0, 0.0]))

    return paint


def wall_entries(wall: Wall) -> list[Entry]:
    """Entries for what the wall itself shows."""
    words = {"friction": "hold, friction cone", "pin": "pin", "magnet": "magnet, friction cone"}
    first = {each.grip: each for each in reversed(wall.holds)}
    entries = [(hold(first[grip]), words[grip]) for grip in CONES if grip in first]
    if wall.obstacles or wall.solids:
        entries.append((box(OBSTACLE, 0.75, ROCK_EDGE), "obstacle"))
    return entries


def paint_column(canvas: Canvas, entries: Sequence[Entry], left: float, top: float) -> None:
    """Entries one under the other."""
    with canvas.group("legend"):
        for row, (sign, word) in enumerate(entries):
            at = np.array([left + 10.0, top + 11.0 + 22.0 * row])
            sign(canvas, at)
            canvas.text(at + WORD, word, SIZE, INK, "start")


def paint_row(canvas: Canvas, entries: Sequence[Entry], left: float, top: float, width: float) -> float:
    """Entries side by side, wrapped at `width`; returns the height taken [px]."""
    x, y = left, top
    with canvas.group("legend"):
        for sign, word in entries:
            length = 42.0 + 0.5 * SIZE * len(word)
            if x > left and x + length > left + width:
                x, y = left, y + 22.0
            at = np.array([x + 10.0, y + 11.0])
            sign(canvas, at)
            canvas.text(at + WORD, word, SIZE, INK, "start")
            x += length
    return y + 22.0 - top
