"""Two drawing surfaces with one set of calls: an SVG document and a smoothed raster image.

Whatever is drawn on one can be drawn on the other, so the pictures and the animation share their drawing code. Both
take pixels, x to the right and y down from the upper left corner; a `View` turns metres of the wall plane into pixels.
Writing the SVG here takes a millisecond, where importing a plotting library takes half a second.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache
from typing import Literal, Protocol
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont

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


def _number(value: float) -> str:
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def _pairs(points: ArrayLike) -> str:
    return " ".join(f"{_number(x)},{_number(y)}" for x, y in np.asarray(points, dtype=float))


class SvgCanvas:
    """Collects the elements of an SVG document; the same calls give the same text."""

    def __init__(self, width: float, height: float, title: str, background: str = "#ffffff") -> None:
        self.width, self.height, self.title = width, height, title
        self._elements = [f'<rect width="100%" height="100%" fill="{background}"/>']

    def polygon(
        self, points: ArrayLike, fill: str | None, alpha: float = 1.0, stroke: str | None = None, width: float = 1.0
    ) -> None:
        """A closed polygon."""
        self._elements.append(f'<polygon points="{_pairs(points)}" {_paint(fill, alpha, stroke, width)}/>')

    def line(
        self, points: ArrayLike, color: str, width: float = 1.0, alpha: float = 1.0, dash: float | None = None
    ) -> None:
        """A polyline."""
        opacity = "" if alpha == 1.0 else f' stroke-opacity="{_number(alpha)}"'
        dashes = "" if dash is None else f' stroke-dasharray="{_number(dash)}"'
        self._elements.append(
            f'<polyline points="{_pairs(points)}" fill="none" stroke="{color}" stroke-width="{_number(width)}" '
            f'stroke-linecap="{"round" if dash is None else "butt"}" stroke-linejoin="round"{opacity}{dashes}/>'
        )

    def disk(
        self,
        center: ArrayLike,
        radius: float,
        fill: str | None,
        alpha: float = 1.0,
        stroke: str | None = None,
        width: float = 1.0,
    ) -> None:
        """A circle."""
        x, y = np.asarray(center, dtype=float)
        self._elements.append(
            f'<circle cx="{_number(x)}" cy="{_number(y)}" r="{_number(radius)}" {_paint(fill, alpha, stroke, width)}/>'
        )

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
        """One line of text."""
        x, y = np.asarray(at, dtype=float)
        # Neither dominant-baseline nor paint-order is known to every viewer; capitals are about 0.7 em tall.
        place = f'x="{_number(x)}" y="{_number(y + 0.35 * size)}" font-size="{_number(size)}" text-anchor="{anchor}"'
        weight = ' font-weight="bold"' if bold else ""
        words = f"{weight}>{escape(text)}</text>"
        if halo:
            self._elements.append(f'<text {place} fill="none" stroke="{HALO}" stroke-width="3"{words}')
        self._elements.append(f'<text {place} fill="{color}"{words}')

    @contextmanager
    def group(self, title: str) -> Iterator[None]:
        """A group whose title viewers show as a tooltip."""
        self._elements.append(f"<g><title>{escape(title)}</title>")
        yield
        self._elements.append("</g>")

    def document(self) -> str:
        """The SVG document."""
        width, height = _number(self.width), _number(self.height)
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
            f'font-family="Helvetica, Arial, DejaVu Sans, sans-serif">\n<title>{escape(self.title)}</title>'
        )
        return "\n".join([head, *self._elements, "</svg>\n"])


def _paint(fill: str | None, alpha: float, stroke: str | None, width: float) -> str:
    opacity = "" if fill is None or alpha == 1.0 else f' fill-opacity="{_number(alpha)}"'
    edge = "" if stroke is None else f' stroke="{stroke}" stroke-width="{_number(width)}" stroke-linejoin="round"'
    return f'fill="{fill or "none"}"{opacity}{edge}'


@cache
def _color(color: str, alpha: float) -> tuple[int, int, int, int]:
    red, green, blue = ImageColor.getrgb(color)[:3]
    return red, green, blue, round(255 * alpha)


@cache
def _font(size: float) -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
    return ImageFont.load_default(size)


class RasterCanvas:
    """Draws on an image several times as fine as the one that is wanted, which smooths edges when it is reduced."""

    def __init__(self, image: Image.Image, fineness: int) -> None:
        """Draws on `image`, whose size is `fineness` times that of the picture; it is changed in place."""
        self.image, self.fineness = image, fineness
        self._draw = ImageDraw.Draw(image, "RGBA")

    @classmethod
    def blank(cls, width: int, height: int, fineness: int = 2, background: str = "#ffffff") -> RasterCanvas:
        """A canvas of one colour for a picture of `width` times `height` pixels."""
        return cls(Image.new("RGB", (width * fineness, height * fineness), background), fineness)

    def picture(self) -> Image.Image:
        """The smoothed picture."""
        return self.image.reduce(self.fineness)

    def _fine(self, points: ArrayLike) -> NDArray[np.float64]:
        return np.asarray(points, dtype=float) * self.fineness

    def polygon(
        self, points: ArrayLike, fill: str | None, alpha: float = 1.0, stroke: str | None = None, width: float = 1.0
    ) -> None:
        """A closed polygon."""
        corners = np.asarray(points, dtype=float)
        if fill is not None:
            self._draw.polygon(self._fine(corners).ravel().tolist(), fill=_color(fill, alpha))
        if stroke is not None:
            self.line(np.vstack([corners, corners[:1]]), stroke, width)

    def line(
        self, points: ArrayLike, color: str, width: float = 1.0, alpha: float = 1.0, dash: float | None = None
    ) -> None:
        """A polyline."""
        ink, thick = _color(color, alpha), max(1, round(width * self.fineness))
        for piece in [np.asarray(points, dtype=float)] if dash is None else dashes(points, dash):
            fine = self._fine(piece)
            self._draw.line(fine.ravel().tolist(), fill=ink, width=thick, joint="curve")
            if dash is None and alpha == 1.0 and thick > 3:
                for x, y in (fine[0], fine[-1]):
                    self._draw.ellipse((x - thick / 2, y - thick / 2, x + thick / 2, y + thick / 2), fill=ink)

    def disk(
        self,
        center: ArrayLike,
        radius: float,
        fill: str | None,
        alpha: float = 1.0,
        stroke: str | None = None,
        width: float = 1.0,
    ) -> None:
        """A circle."""
        x, y = self._fine(center)
        half = radius * self.fineness
        if stroke is not None:  # half of the line's width lies outside, as in SVG
            half += width * self.fineness / 2
        self._draw.ellipse(
            (x - half, y - half, x + half, y + half),
            fill=None if fill is None else _color(fill, alpha),
            outline=None if stroke is None else _color(stroke, 1.0),
            width=max(1, round(width * self.fineness)),
        )

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
        """One line of text."""
        x, y = self._fine(at)
        font, place = _font(size * self.fineness), {"start": "lm", "middle": "mm", "end": "rm"}[anchor]
        ink, shifts = _color(color, 1.0), (0.0, 0.5 * self.fineness) if bold else (0.0,)
        if halo:
            light = _color(HALO, 1.0)
            self._draw.text((x, y), text, fill=light, font=font, anchor=place, stroke_width=round(1.5 * self.fineness))
        for shift in shifts:  # the font that comes with Pillow has one weight only
            self._draw.text((x + shift, y), text, fill=ink, font=font, anchor=place)

    def group(self, title: str) -> AbstractContextManager[None]:
        """Images know no groups."""
        return nullcontext()


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
