"""An SVG document to draw on. Writing one takes a millisecond; importing a plotting library takes half a second."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import ArrayLike

from climber.canvas import HALO, Anchor
from climber.files import write_text


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

    def save(self, path: str | Path) -> None:
        """Writes the document, whole or not at all."""
        write_text(path, self.document())


def _number(value: float) -> str:
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def _pairs(points: ArrayLike) -> str:
    return " ".join(f"{_number(x)},{_number(y)}" for x, y in np.asarray(points, dtype=float))


def _paint(fill: str | None, alpha: float, stroke: str | None, width: float) -> str:
    opacity = "" if fill is None or alpha == 1.0 else f' fill-opacity="{_number(alpha)}"'
    edge = "" if stroke is None else f' stroke="{stroke}" stroke-width="{_number(width)}" stroke-linejoin="round"'
    return f'fill="{fill or "none"}"{opacity}{edge}'
