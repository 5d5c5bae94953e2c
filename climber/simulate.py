"""Plans climbed in contact simulation: do the robots fall, slip, or keep to the plan?

The world is that of `climber.simulation_model`, and every robot's motors do what `climber.controller` says. Robots and
holds can be made to differ from what the plan was made for, which controllers are not told. docs/simulation.md says
what is modelled and what is not.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context

import numpy as np

from climber.least_margins import least_margins
from climber.plan_file import Plan
from climber.simulation import SLIP_LIMIT, Perturbation, Simulation
from climber.simulation_loop import Loop, Setting
from climber.stance import Vector

TIME_STEP = 0.002  # [s]
SAME = 1e-4  # [m, rad, and by the second] robots nearer to where others were at the same phases go on as those did


def simulate(
    plan: Plan | Setting,
    perturbation: Perturbation | None = None,
    slip_limit: float = SLIP_LIMIT,
    time_step: float = TIME_STEP,
) -> Simulation:
    """Climbs a plan.

    Args:
        plan: The plan.
        perturbation: How the world differs from the plan's; by default it does not.
        slip_limit: What a holding foot may slip [m].
        time_step: Of the simulation and of the controllers [s].

    Raises:
        ClimberError: If the plan's scenario or a model cannot be read, or does not go with the plan.
    """
    (result,) = simulate_starts(plan, [perturbation or Perturbation()], slip_limit, time_step)
    return result


def simulate_starts(
    plan: Plan | Setting,
    perturbations: Sequence[Perturbation],
    slip_limit: float = SLIP_LIMIT,
    time_step: float = TIME_STEP,
) -> list[Simulation]:
    """Climbs a plan from several starts, where nothing differs but how the robots start.

    The first climb is to its end. Others are until all robots are in the state, feet and all, that they were in during
    an earlier climb as the same phases began, to `SAME`: what comes then is that climb again.

    Args:
        plan: The plan.
        perturbations: How the world differs from the plan's, and where the robots start.
        slip_limit: What a holding foot may slip [m].
        time_step: Of the simulation and of the controllers [s].

    Raises:
        ClimberError: If the plan's scenario or a model cannot be read, or does not go with the plan.
    """
    setting = plan if isinstance(plan, Setting) else Setting(plan)
    known: dict[tuple[int, ...], Vector] = {}
    result = []
    for perturbation in perturbations:
        began, met = time.perf_counter(), False
        phases: tuple[int, ...] = ()
        loop = Loop(setting, perturbation, time_step)
        while loop.going and not met:
            loop.step()
            now = tuple(watch.controller.phase for watch in loop.watches)
            if now != phases:
                phases, state = now, np.concatenate([part for robot in loop.world.state() for part in robot])
                before = known.setdefault(phases, state)
                met = before is not state and bool(np.abs(before - state).max() < SAME)
        result.append(
            Simulation(
                robots=tuple(watch.result() for watch in loop.watches),
                perturbation=perturbation,
                planned=setting.duration,
                simulated=loop.elapsed,
                seconds=time.perf_counter() - began,
                slip_limit=slip_limit,
            )
        )
    return result


@dataclass(frozen=True)
class Survival:
    """How one perturbation was survived, over several seeds.

    Attributes:
        perturbation: The perturbation, with the first of the seeds.
        runs: The simulations, a seed each.
    """

    perturbation: Perturbation
    runs: tuple[Simulation, ...]

    @property
    def survived(self) -> int:
        """How many runs ended without a fall and without a slip beyond the limit."""
        return sum(run.ok for run in self.runs)

    @property
    def falls(self) -> int:
        """How many runs ended in a fall."""
        return sum(run.fell for run in self.runs)

    @property
    def slip(self) -> float:
        """Worst slip in a run without a fall [m]; NaN if there is none."""
        return max((run.slip for run in self.runs if not run.fell), default=float("nan"))


def certified(plan: Plan, perturbation: Perturbation) -> bool | None:
    """Whether the plan's margins say that a perturbation is survived; None if they say nothing of its kind.

    Margins are of one error at a time, and of one hold out of place; of all displaced at once they say nothing.
    """
    errors, margins = perturbation.errors, least_margins(plan)
    if not errors:
        return True if margins else None
    if len(errors) > 1 or not set(errors) <= set(margins) or (errors.keys() == {"place"} and perturbation.hold is None):
        return None
    return all(size <= margins[kind] for kind, size in errors.items())


def monte_carlo(
    plan: Plan,
    perturbations: Sequence[Perturbation],
    runs: int,
    slip_limit: float = SLIP_LIMIT,
    processes: int | None = None,
) -> list[Survival]:
    """Climbs a plan under each of several perturbations with `runs` seeds, counted up from that of the perturbation.

    Args:
        plan: The plan.
        perturbations: How the world differs from the plan's.
        runs: How many seeds each is tried with.
        slip_limit: What a holding foot may slip [m].
        processes: How many processes share the work; by default one a processor. The results do not depend on it.

    Raises:
        ClimberError: If the plan's scenario or a model cannot be read, or does not go with the plan.
    """
    tasks = [replace(one, seed=one.seed + run) for one in perturbations for run in range(runs)]
    done = iter(_all(plan, tasks, slip_limit, min(len(tasks), processes or os.cpu_count() or 1)))
    return [Survival(one, tuple(next(done) for _ in range(runs))) for one in perturbations]


def _all(plan: Plan, tasks: Sequence[Perturbation], slip_limit: float, processes: int) -> Iterator[Simulation]:
    if processes == 1:
        setting = Setting(plan)
        yield from (simulate(setting, task, slip_limit) for task in tasks)
        return
    Setting(plan)  # what is wrong with the plan is told before there are processes
    with ProcessPoolExecutor(processes, get_context("spawn"), _settle, (plan, slip_limit)) as pool:
        yield from pool.map(_one, tasks)


_worker: list[tuple[Setting, float]] = []  # of a worker process: what it simulates


def _settle(plan: Plan, slip_limit: float) -> None:
    _worker[:] = [(Setting(plan), slip_limit)]


def _one(task: Perturbation) -> Simulation:
    (setting, slip_limit) = _worker[0]
    return simulate(setting, task, slip_limit)
