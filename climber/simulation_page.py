"""What came of a simulation, as a plan that pictures can be made of, and as a Meshcat page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from climber.files import write_text
from climber.meshcat_page import meshcat_page
from climber.plan_file import Plan
from climber.plan_parts import Phase, RobotPlan
from climber.scene import Scene
from climber.simulation import RobotRun, Simulation


def recorded(plan: Plan, simulation: Simulation) -> Plan:
    """The plan with what was done in place of what was planned; it ends where the simulation did.

    Its forces are those that the controller meant to make. It is for looking at: accelerations are left at zero.
    """
    robots = [_recorded(part, run) for part, run in zip(plan.robots, simulation.robots, strict=True)]
    return replace(plan, robots=tuple(robots))


def _recorded(plan: RobotPlan, run: RobotRun) -> RobotPlan:
    track, phases = run.track, []
    for number, phase in enumerate(plan.phases):
        rows = np.flatnonzero(track.phase == number)
        if len(rows) >= 2:
            phases.append(_phase(phase, run, rows))
    if not phases:  # it fell at once, or could not even begin: it stands as it was to begin
        first = plan.phases[0]
        begin = {name: getattr(first, name)[:2] for name in ("time", "q", "v", "vd", "torque")}
        force = {limb: rows[:2] for limb, rows in first.force.items()}
        return replace(plan, phases=(replace(first, **begin, force=force, moment={}),))
    return replace(
        plan, positions=run.positions, velocities=run.velocities, joints=tuple(run.torque), phases=tuple(phases)
    )


def _phase(phase: Phase, run: RobotRun, rows: np.ndarray) -> Phase:
    track, limbs = run.track, list(run.limbs)
    return replace(
        phase,
        time=track.time[rows],
        q=track.q[rows],
        v=track.v[rows],
        vd=np.zeros_like(track.v[rows]),
        torque=track.torque[rows],
        force={contact.limb: track.force[rows, limbs.index(contact.limb)] for contact in phase.contacts},
        moment={},
    )


def draw_recording(plan: Plan, simulation: Simulation, path: str | Path) -> None:
    """Writes the Meshcat page of a simulation, whole or not at all.

    Raises:
        ClimberError: If the plan's scenario, or a robot's model, cannot be read or does not go with the plan.
    """
    scene = Scene.of(recorded(plan, simulation))
    falls = [f"{run.name} fell: {run.fell}" for run in simulation.robots if run.fell]
    outcome = "; ".join(falls) or f"worst slip {1e3 * simulation.slip:.2f} mm"
    write_text(path, meshcat_page(scene, f"{scene.scenario.name}, simulated: {outcome}"))
