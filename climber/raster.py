"""An image to draw on."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont

from climber.canvas import HALO, Anchor, dashes
from climber.files import atomic_path


class RasterCanvas:
    """Draws on an image several times as fine as the one that is wanted, which smooths edges when it is reduced."""

    def __init__(self, image: Image.Image, fineness: int, zoom: int = 1) -> None:
        """Draws on an image.

        Args:
            image: The image, which is changed in place.
            fineness: How many of its pixels make the side of a pixel that is drawn in.
            zoom: How many pixels of the finished picture do.
        """
        self.image, self.fineness, self.zoom = image, fineness, zoom
        self._draw = ImageDraw.Draw(image, "RGBA")

    @classmethod
    def blank(cls, width: float, height: float, fineness: int = 2, zoom: int = 1) -> RasterCanvas:
        """A white canvas of `width` times `height` pixels."""
        size = (int(np.ceil(width)) * fineness, int(np.ceil(height)) * fineness)
        return cls(Image.new("RGB", size, "#ffffff"), fineness, zoom)

    def picture(self) -> Image.Image:
        """The smoothed picture."""
        return self.image.reduce(self.fineness // self.zoom)

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

    def save(self, path: str | Path) -> None:
        """Writes the picture in the format of the path's suffix, whole or not at all."""
        with atomic_path(path) as aside:
            self.picture().save(aside)


@cache
def _color(color: str, alpha: float) -> tuple[int, int, int, int]:
    red, green, blue = ImageColor.getrgb(color)[:3]
    return red, green, blue, round(255 * alpha)


@cache
def _font(size: float) -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
    return ImageFont.load_default(size)
