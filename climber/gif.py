"""Frames into an animated GIF with one palette of their most frequent colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from climber.files import atomic_path

Pixels = NDArray[np.uint8]

SAMPLES = 8  # frames that the palette is chosen from, by every second pixel of every second row
COLORS = 255  # one fewer than GIF allows: the encoder marks unchanged pixels with the last


@dataclass(frozen=True)
class Frame:
    """A picture told as what differs from a backdrop that frames share.

    Attributes:
        backdrop: The common picture; frames with the same one hold the same object.
        patches: What is laid over it: upper left corner (x, y) [px] and picture.
    """

    backdrop: Image.Image
    patches: tuple[tuple[tuple[int, int], Image.Image], ...]

    def picture(self) -> Image.Image:
        """The whole picture."""
        whole = self.backdrop.copy()
        for corner, patch in self.patches:
            whole.paste(patch, corner)
        return whole


class Palette:
    """The most frequent colours of some pictures, and for any colour the nearest of them.

    Colours are told apart by the upper five bits of each channel.
    """

    def __init__(self, pictures: Sequence[Image.Image]) -> None:
        pixels = np.concatenate([np.asarray(picture)[::2, ::2].reshape(-1, 3) for picture in pictures])
        cells = _cells(pixels)
        counts = np.bincount(cells, minlength=1 << 15)
        most = np.argsort(-counts, kind="stable")[:COLORS]
        most = most[counts[most] > 0]
        sums = [np.bincount(cells, weights=pixels[:, channel], minlength=1 << 15) for channel in range(3)]
        means = np.stack(sums, axis=1)[most] / counts[most, None]
        self.colors: Pixels = means.round().astype(np.uint8)
        every = np.arange(1 << 15)
        middles = 8.0 * np.stack([every >> 10, every >> 5 & 31, every & 31], axis=1) + 3.5
        squares = (means**2).sum(axis=1)
        # |a - b|^2 less |a|^2, which does not change which b is nearest; in pieces that stay in the cache
        nearest = [(squares - 2.0 * part @ means.T).argmin(axis=1) for part in np.split(middles, 64)]
        self._nearest: Pixels = np.concatenate(nearest).astype(np.uint8)
        self._nearest[most] = np.arange(len(most))

    def indices(self, picture: Image.Image) -> Pixels:
        """The palette's number for every pixel, shape (height, width)."""
        result: Pixels = self._nearest[_cells(np.asarray(picture))]
        return result


def _cells(pixels: Pixels) -> NDArray[np.int32]:
    coarse = (pixels >> 3).astype(np.int32)
    result: NDArray[np.int32] = coarse[..., 0] << 10 | coarse[..., 1] << 5 | coarse[..., 2]
    return result


def write_gif(path: str | Path, frames: Sequence[Frame], durations: Sequence[int]) -> None:
    """Writes an endlessly repeated GIF, whole or not at all.

    Args:
        path: The file.
        frames: The frames, all of one size.
        durations: How long each is shown [ms].
    """
    chosen = np.unique(np.linspace(0, len(frames) - 1, SAMPLES).round().astype(int))
    palette = Palette([frames[i].picture() for i in chosen])
    backdrops: dict[int, Pixels] = {}
    images = []
    for frame in frames:
        if id(frame.backdrop) not in backdrops:
            backdrops[id(frame.backdrop)] = palette.indices(frame.backdrop)
        indices = backdrops[id(frame.backdrop)].copy()
        for (x, y), patch in frame.patches:
            indices[y : y + patch.height, x : x + patch.width] = palette.indices(patch)
        image = Image.frombytes("P", frame.backdrop.size, indices.tobytes())
        image.putpalette(palette.colors.tobytes())
        images.append(image)
    with atomic_path(path) as aside:
        images[0].save(aside, format="GIF", save_all=True, append_images=images[1:], duration=list(durations), loop=0)
