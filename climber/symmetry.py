"""Rotations that map a robot onto itself: what its description declares, checked against its model.

A declared symmetry lets the planner take one stance for another, so a wrong one would silently lose climbs or invent
them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from climber.stance import Vector

if TYPE_CHECKING:
    from climber.robot import Robot

Permutation = tuple[int, ...]
TOLERANCE = 1e-6  # [m, kg m, ...] models are written with so many digits
ANGLES = (0.0, 0.7, -1.1)  # [rad] at which limbs are compared; a joint's is this plus a tenth for every joint before it


def symmetry_group(robot: Robot) -> tuple[Permutation, ...]:
    """All that follows from the declared symmetries by repeating and combining them, the identity first.

    Returns:
        Limb permutations: limb `i` takes the place of limb `permutation[i]`.

    Raises:
        ModelError: If a declared symmetry is no rotation of the pelvis about its z axis.
    """
    names = robot.limb_names
    declared = [tuple(names.index(name) for name in order) for order in robot.model.symmetries]
    for number, permutation in enumerate(declared):
        _check(robot, permutation, number)
    identity = tuple(range(len(names)))
    group, fresh = {identity}, [identity]
    while fresh:
        one = fresh.pop()
        products = {tuple(one[i] for i in other) for other in declared} - group
        group |= products
        fresh += sorted(products)
    return tuple(sorted(group))  # the identity is the least


def _signatures(robot: Robot, angle: float) -> tuple[Vector, Vector]:
    """What a rotation must carry from limb to limb, seen from the pelvis with all limbs bent alike.

    Returns:
        For each limb the foot [m] and the moment of its mass [kg m], shape (num_limbs, 2, 3), and what must be equal,
        shape (num_limbs, k): mass, number of joints, and their limits.
    """
    plant, context = robot.plant, robot.context()
    for limb in robot.limbs:
        for j, place in enumerate(limb.q):
            q = plant.GetPositions(context)
            q[place] = angle + 0.1 * j
            plant.SetPositions(context, q)
    X_PW = robot.pelvis.EvalPoseInWorld(context).inverse()
    vectors, numbers = [], []
    for limb, foot in zip(robot.limbs, robot.foot_positions(context), strict=True):
        mass, moment = 0.0, np.zeros(3)
        joints = [joint for joint in robot.chain(limb.foot) if joint.num_positions()]
        for joint in joints:
            for body in plant.GetBodiesWeldedTo(joint.child_body()):
                center = body.EvalPoseInWorld(context) @ body.CalcCenterOfMassInBodyFrame(context)
                mass += body.get_mass(context)
                moment += body.get_mass(context) * (X_PW @ center)
        vectors.append([X_PW @ foot, moment])
        numbers.append(np.concatenate([[mass, len(joints)], limb.lower, limb.upper, limb.velocity, limb.effort]))
    width = max(len(row) for row in numbers)
    padded = np.array([np.pad(np.nan_to_num(row, posinf=1e9, neginf=-1e9), (0, width - len(row))) for row in numbers])
    return np.array(vectors), padded


def _check(robot: Robot, permutation: Permutation, number: int) -> None:
    """Raises unless some rotation of the pelvis about z puts every limb exactly where another is."""
    to = list(permutation)
    every = [_signatures(robot, angle) for angle in ANGLES]
    vectors = np.concatenate([v for v, _ in every], axis=1)  # (num_limbs, 2 * len(ANGLES), 3)
    numbers = every[0][1]
    # The rotation that fits best, all feet and moments taken as complex numbers.
    plane = vectors[..., 0] + 1j * vectors[..., 1]
    turn = np.exp(1j * np.angle((np.conj(plane) * plane[to]).sum()))
    off = np.abs(turn * plane - plane[to]).max(axis=1) + np.abs(vectors[..., 2] - vectors[to, :, 2]).max(axis=1)
    unlike = np.abs(numbers - numbers[to]).max(axis=1)
    context = robot.context()
    welded = robot.plant.GetBodiesWeldedTo(robot.pelvis)
    X_PW = robot.pelvis.EvalPoseInWorld(context).inverse()
    own = sum(
        body.get_mass(context) * (X_PW @ body.EvalPoseInWorld(context) @ body.CalcCenterOfMassInBodyFrame(context))
        for body in welded
    )
    lopsided = np.hypot(*own[:2]) * abs(turn - 1)
    name = robot.limb_names
    if off.max() > TOLERANCE or unlike.max() > TOLERANCE:
        worst = int(np.argmax(np.where(off > TOLERANCE, off, unlike)))
        what = f"{off[worst]:.3g} m apart" if off[worst] > TOLERANCE else "unlike in mass or limits"
        allowed = (
            f"limbs that a rotation of the pelvis about z takes to each other; turned by "
            f"{np.degrees(np.angle(turn)):.1f} degrees, {name[worst]} and {name[to[worst]]} are {what}"
        )
    elif lopsided > TOLERANCE:
        allowed = "rotations that leave the pelvis's centre of mass where it is"
    else:
        return
    raise robot.model.error(f"symmetries[{number}]", [name[i] for i in to], allowed)
