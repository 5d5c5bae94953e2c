"""The climb as an animated GIF, drawn and encoded fast enough to be written after every solve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from climber import marks
from climber.gif import Frame, write_gif
from climber.picture import (
    FAINT,
    FORCE,
    INK,
    arrow,
    bounds,
    corners,
    fit,
    paint_center_of_mass,
    paint_numbers,
    paint_robot,
    paint_support,
    paint_wall,
)
from climber.plan_file import Plan
from climber.raster import RasterCanvas
from climber.replay import Moment
from climber.scene import Scene

FINENESS = 2  # what moves is drawn this many times as large, then reduced
WIDEST, TALLEST = 680.0, 560.0  # the most the wall may take [px]
CAPTION = 44  # [px]
EDGE = 12  # [px]
CLOCK = (80, 24)  # what the time of a frame takes, in the upper right corner [px]
SPEEDS = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
MOST_FRAMES = 220
FRAME_TIME = 50  # [ms], a multiple of the 10 ms that GIF counts in
LAST_FRAME_TIME = 1500  # [ms]
FORCE_LENGTH = 0.11  # an arrow for a force as great as the weight is this long [m]


@dataclass(frozen=True)
class Reel:
    """What an animation is made of.

    Attributes:
        times: Time in the climb of each frame [s], shape (num_frames,).
        speed: Seconds of the climb per second of the animation.
    """

    times: NDArray[np.float64]
    speed: float

    @classmethod
    def of(cls, scene: Scene) -> Reel:
        """Even frames of a whole climb at the least round speed that keeps them few; the last is the climb's end."""
        start, end = scene.start, scene.end
        fastest = (end - start) / (MOST_FRAMES - 1) / (FRAME_TIME / 1000.0)
        speed = next((s for s in SPEEDS if s >= max(fastest, 1.0)), float(np.ceil(fastest)))
        step = speed * FRAME_TIME / 1000.0
        return cls(np.append(np.arange(start, end - 1e-9, step), end), speed)


class Animator:
    """Draws the frames of a climb. Only what moves is drawn for each; the rest is drawn once for each phase."""

    def __init__(self, scene: Scene, speed: float) -> None:
        self._scene, self._climbs, self._speed = scene, scene.climbs, speed
        lower, upper = bounds(scene.wall, scene.covered)
        scale = min(WIDEST / (upper - lower)[0], TALLEST / (upper - lower)[1])
        width, height = (int(length) for length in np.ceil(scale * (upper - lower)))
        self.size = (width + 2 * EDGE, height + CAPTION + EDGE)
        self._view = fit(lower, upper, EDGE, CAPTION, width, height)
        self._phases: tuple[int, ...] = ()
        self._fine = self._backdrop = Image.new("RGB", (0, 0))

    def _set_backdrop(self, phases: tuple[int, ...]) -> None:
        """The wall and the support bands while the robots are in these phases."""
        canvas = RasterCanvas.blank(*self.size, FINENESS)
        for climb, phase in zip(self._climbs, phases, strict=True):
            paint_support(canvas, self._view, climb, phase)
        for spec in self._scene.scenario.robots:
            marks.paint_goal_region(canvas, self._view, spec)
        paint_wall(canvas, self._view, self._scene.wall)
        paint_numbers(canvas, self._view, self._scene.wall, 12.0)
        canvas.polygon(corners(self._view), None, stroke=FAINT)
        right = self.size[0] - EDGE
        canvas.text((EDGE, 14.0), self._scene.title, 14.0, INK, "start", bold=True)
        words = (climb.describe(phase) for climb, phase in zip(self._climbs, phases, strict=True))
        canvas.text((EDGE, 32.0), "      ".join(words), 13.0, INK, "start")
        if self._speed != 1.0:
            canvas.text((right, 32.0), f"played {self._speed:g} times as fast", 13.0, INK, "end")
        self._phases, self._fine, self._backdrop = phases, canvas.image, canvas.picture()

    def frame(self, time: float) -> Frame:
        """The picture at `time` [s]."""
        moments = [climb.at(time) for climb in self._climbs]
        phases = tuple(moment.phase for moment in moments)
        if phases != self._phases:
            self._set_backdrop(phases)
        canvas = RasterCanvas(self._fine.copy(), FINENESS)
        left, top, right, bottom = self.paint_moving(canvas, moments)
        box = (FINENESS * left, FINENESS * top, FINENESS * right, FINENESS * bottom)
        moving = canvas.image.reduce(FINENESS, box=box)
        clock = RasterCanvas.blank(*CLOCK, 1)
        clock.text((CLOCK[0], 14.0), f"{time:.1f} s", 13.0, INK, "end")
        return Frame(self._backdrop, (((left, top), moving), ((self.size[0] - EDGE - CLOCK[0], 0), clock.image)))

    def paint_moving(self, canvas: RasterCanvas, moments: Sequence[Moment]) -> tuple[int, int, int, int]:
        """Robots, forces and centres of mass.

        Returns:
            The left, upper, right and lower edge of the pixels that may have changed.
        """
        drawn = []
        for climb, moment in zip(self._climbs, moments, strict=True):
            outline = climb.outline(moment)
            paint_robot(canvas, self._view, climb.looks, outline, climb.moving(moment.phase))
            for point, force in moment.forces.values():
                head = point + FORCE_LENGTH / climb.weight * force
                arrow(canvas, self._view(point), self._view(head), FORCE, 2.0)
                drawn.append(head[None, :2])
            paint_center_of_mass(canvas, self._view, outline.center_of_mass, 6.0)
            drawn += [outline.points, np.array([[outline.center_of_mass[0], self._view.lower[1]]])]
        # Wide enough for the width of links and joints around the points.
        reach = 10.0 + self._view.scale * max(climb.looks.thickness for climb in self._climbs)
        around = self._view(np.vstack(drawn))
        left, top = np.clip(np.floor(around.min(axis=0) - reach), 0, self.size).astype(int).tolist()
        right, bottom = np.clip(np.ceil(around.max(axis=0) + reach), 0, self.size).astype(int).tolist()
        return left, top, right, bottom


def draw_animation(plan: Plan | Scene, path: str | Path) -> None:
    """Writes the animation of a climb as a GIF, whole or not at all.

    Raises:
        ClimberError: If the plan's scenario, or a robot's model, cannot be read or does not go with the plan.
    """
    scene = plan if isinstance(plan, Scene) else Scene.of(plan)
    reel = Reel.of(scene)
    animator = Animator(scene, reel.speed)
    frames = [animator.frame(time) for time in reel.times]
    write_gif(path, frames, [FRAME_TIME] * (len(frames) - 1) + [LAST_FRAME_TIME])
