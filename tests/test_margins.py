"""Margins: what is claimed is survived by the torque program, what is more is not, and simple cases are as by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from plans import AT_THE_EDGE, edge_plan, step_plan, with_margins
from problems import hold

from climber.demands import Standing
from climber.dynamics import evaluate_at_rest
from climber.margins import phase_margins
from climber.plan_parts import CAPS, MarginKind, PhaseMargin
from climber.programs.forces import wall_forces
from climber.programs.grip_margins import ErrorMargin, FrictionError, NormalError
from climber.programs.grips import wall_grips
from climber.programs.instants import Instants as Equations
from climber.programs.instants import Margin
from climber.programs.margins import GAP, DisturbanceMargin
from climber.programs.rays import rays
from climber.programs.survival import Instants
from climber.programs.torque import TorqueProgram
from climber.robot import Robot
from climber.scenario import load_scenario, scenario_from_text
from climber.scenario_fields import KEPT, MinMargin
from climber.stance import Contact, Vector
from climber.timing import Samples
from climber.verify_survival import Give
from climber.wall import Hold, Wall

QUADRUPED = "package://climber/quadruped/quadruped.urdf"
STANDING = np.array([0, 0, 0, -0.6, 1.2, 0.6, -1.2, -0.6, 1.2, 0.6, -1.2])
W = 20.0  # [N]
seeds = st.integers(0, 2**32 - 1)


def point_mass(*holds: Hold) -> tuple[Instants, Wall]:
    """A mass of 20 N on holds, without extension or motors."""
    wall = Wall(holds)
    rows, most = wall_grips(wall, 2).rows()
    k, R, _ = rows.shape
    G = np.zeros((1, k * R, 2 * k))
    for i in range(k):
        G[0, i * R : (i + 1) * R, 2 * i : 2 * i + 2] = rows[i, :, :2]
    E = np.tile(np.eye(2), (1, k))[None]
    g, weight = most.ravel()[None], np.ones(k * R)
    instants = Instants(E, np.array([[0.0, W]]), G, g, weight, np.zeros(1, dtype=int), np.linalg.pinv(E))
    return instants, wall


def push(*holds: Hold) -> float:
    """The greatest push on a mass in any direction [N]."""
    instants, _ = point_mass(*holds)
    B, C = -np.eye(2)[None], np.zeros((1, instants.G.shape[1], 2))
    return float(DisturbanceMargin(instants, B, C, 1000.0, rays(2)).solve()[0].value[0])


def of_grips(kind: type[FrictionError] | type[NormalError], *holds: Hold) -> float:
    """The greatest error of friction or of a normal under a mass."""
    instants, wall = point_mass(*holds)
    grips = wall_grips(wall, 2)
    return float(ErrorMargin(instants, kind(grips, len(holds), 2, 1.0)).solve().value[0])


def near(exact: float, gap: float = 0.5 * GAP) -> object:
    """As great as it may be said to be: the exact value or a little less."""
    return pytest.approx(exact * (1.0 - gap), rel=gap * 1.05)


def test_a_mass_on_a_flat_hold_is_pushed_as_far_as_the_edge_of_its_cone() -> None:
    """The edge of the cone is W sin(atan mu) away from the load W along its axis."""
    for mu in (0.2, 0.6, 1.5):
        assert push(hold(0, 0, friction=mu, max_force=100.0)) == near(W * math.sin(math.atan(mu)))


def test_two_holds_push_no_farther_than_one_unless_it_is_full() -> None:
    """Cones that are alike add up to the same cone; limits on normal forces do add up."""
    flat = hold(0, 0, friction=0.6, max_force=100.0)
    assert push(flat, replace(flat, position=(1.0, 0.0, 0.0))) == near(W * math.sin(math.atan(0.6)))
    # A hold of at most 24 N along its normal has 4 N left above the load, two of them 28 N.
    edge = math.cos(math.atan(2.0))
    full = hold(0, 0, friction=2.0, max_force=12.0 / edge)
    assert push(full) == near(4.0 / math.sqrt(1.25))
    assert push(full, full) == near(min(28.0 / math.sqrt(1.25), W * math.sin(math.atan(2.0))))


def test_a_leaning_hold_may_lose_friction_until_it_is_the_slope() -> None:
    for slope in (5.0, 20.0, 30.0):
        leaning = hold(0, 0, slope, friction=0.8, max_force=100.0)
        assert of_grips(FrictionError, leaning) == near(1.0 - math.tan(math.radians(slope)) / 0.8)
        assert of_grips(NormalError, leaning) == near(math.atan(0.8) - math.radians(slope))


def test_a_pin_knows_no_friction_and_no_normal() -> None:
    pin = hold(0, 0, 70.0, grip="pin", max_force=30.0)
    assert of_grips(FrictionError, pin) == of_grips(NormalError, pin) == 1.0
    assert push(pin) == near(10.0)


def test_a_mass_that_is_not_held_survives_nothing() -> None:
    steep = hold(0, 0, 50.0, friction=0.8)
    assert push(steep) == of_grips(FrictionError, steep) == of_grips(NormalError, steep) == 0.0


def test_less_friction_never_lets_a_hold_push_with_more() -> None:
    rng = np.random.default_rng(3)
    for grip in ("friction", "magnet", "pin"):
        hard = hold(0, 0, 10.0, grip=grip, friction=0.9, min_force=1.0, max_force=20.0, adhesion=4.0)
        soft = hard.slippery(0.3)
        f = np.pad(rng.uniform(-30.0, 30.0, (5000, 2)), ((0, 0), (0, 1)))
        inside = Give.of(soft, True).excess(f) <= 0.0
        assert inside.any() and (Give.of(hard, True).excess(f[inside]) <= 1e-9).all()
        # And it is what the contract of a drop of friction says, worked out another way.
        np.testing.assert_allclose(
            Give.of(soft, True).excess(f), Give.of(hard, True).slippery(0.3).excess(f), atol=1e-9
        )


@pytest.mark.parametrize(("dimension", "gap"), [(1, 0.0), (2, 0.005), (3, 0.07)])
@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_the_ball_in_a_polytope_is_inside_and_nearly_as_large_as_can_be(dimension: int, gap: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(12, dimension))
    normals = np.concatenate([normals, -normals.sum(axis=0, keepdims=True)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = rng.uniform(0.5, 3.0, len(normals))
    around = rays(dimension)
    speed = around.directions @ normals.T
    rho = np.where(speed > 1e-9, offsets / np.maximum(speed, 1e-9), np.inf).min(axis=1)
    assume(rho.max() < 50.0)
    radius, _, raised = around.inscribed(rho[None])
    speed_max = offsets[speed.max(axis=0) > 1e-9].min()
    assert radius[0] <= speed_max + 1e-9
    assert radius[0] >= (1.0 - gap) * rho.min() - 1e-9
    assert (raised[0] <= rho + 1e-9).all()  # chords of a convex set are inside it


@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_the_ball_in_a_jagged_polytope_in_space_is_as_large_as_its_nearest_simplex_allows(seed: int) -> None:
    """The planes of simplices may be much nearer than the simplices: points all over these say where the nearest is."""
    around = rays(3)
    rho = np.random.default_rng(seed).uniform(1.0, 6.0, (1, len(around.directions)))
    radius, _, raised = around.inscribed(rho)
    i, j = np.mgrid[:41, :41]
    shares = np.stack([i, j, 40 - i - j], axis=-1)[i + j <= 40] / 40.0
    points = shares @ (raised[0][around.faces][..., None] * around.directions[around.faces])
    nearest = np.linalg.norm(points, axis=-1).min()
    assert nearest * 0.99 <= radius[0] <= nearest + 1e-9


@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_among_planes_the_ball_in_space_and_the_direction_that_is_worst_are_those_of_the_nearest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    normals = np.concatenate([rng.normal(size=(12, 3)), np.eye(3), -np.eye(3)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = rng.uniform(1.0, 3.0, (2, len(normals)))
    # Disturbances d with normals . d <= offsets, whatever the one contact force between -1 and 1 is.
    G = np.tile(np.vstack([np.zeros((len(normals), 1)), [[1.0], [-1.0]]]), (2, 1, 1))
    C = np.tile(np.vstack([-normals, np.zeros((2, 3))]), (2, 1, 1))
    g, weight = np.hstack([offsets, np.ones((2, 2))]), np.ones(len(normals) + 2)
    none = np.zeros((2, 1, 1))
    instants = Instants(none, none[:, 0], G, g, weight, np.zeros(2, dtype=int), none)
    worst, toward = DisturbanceMargin(instants, np.zeros((2, 1, 3)), C, 100.0, rays(3)).solve()
    assert worst.value[0] <= offsets.min() + 1e-6
    assert worst.value[0] >= 0.93 * offsets.min()
    along = np.maximum(normals @ toward[0], 1e-9)
    assert (offsets[worst.instant[0]] / along).min() <= 1.08 * worst.value[0]


@cache
def named(model: str = QUADRUPED) -> Robot:
    return Robot(model)


def standing(robot: Robot, rng: np.random.Generator) -> tuple[Wall, Standing]:
    """A posture on holds that lean any way, all limbs on or one in the air."""
    q = STANDING + rng.normal(0.0, 0.15, 11)
    context = robot.context()
    robot.plant.SetPositions(context, q)
    feet = robot.foot_positions(context)
    holds = [
        hold(x, y, rng.normal(0.0, 35.0), friction=rng.uniform(0.4, 1.2), min_force=rng.choice([0.0, 0.5]))
        for x, y, _ in feet
    ]
    limbs = [limb for limb in range(4) if limb != rng.integers(0, 8)]
    none = np.zeros((1, 11))
    return Wall(tuple(holds)), Standing(tuple(Contact(i, i) for i in limbs), Samples(np.zeros(1), q[None], none, none))


def pushed(robot: Robot, wall: Wall, at: Standing, force: Vector) -> bool:
    """Whether the torque program finds forces and torques for a posture that is pushed at its centre of mass."""
    q, limbs = at.samples.q, [contact.limb for contact in at.contacts]
    h, J = evaluate_at_rest(robot, q, limbs)
    context = robot.context()
    robot.plant.SetPositions(context, q[0])
    arm = robot.center_of_mass(context) - robot.pelvis.EvalPoseInWorld(context).translation()
    load = h.copy()
    load[0, :2] -= force[:2]
    load[0, 2] -= arm[0] * force[1] - arm[1] * force[0]
    forces = wall_forces(wall)[np.array([contact.hold for contact in at.contacts])]
    return TorqueProgram(Equations.of_loads(robot, forces, load, J, Margin(0.0, 0.0))).solve().ok


def margin(robot: Robot, wall: Wall, at: Standing, kind: MarginKind) -> PhaseMargin:
    """The margin with the share that is not told."""
    told = phase_margins(robot, wall, [at], [kind])[0][kind]
    return replace(told, value=told.value / KEPT)


@given(seed=seeds)
@settings(max_examples=25, deadline=None)
def test_pushes_within_the_margin_are_survived_and_greater_ones_where_it_is_worst_are_not(seed: int) -> None:
    rng, robot = np.random.default_rng(seed), named()
    wall, at = standing(robot, rng)
    found = margin(robot, wall, at, "push")
    assume(found.value > 0.01)
    assert found.direction is not None
    for angle in rng.uniform(0.0, 2.0 * np.pi, 3):
        force = rng.uniform(0.0, 0.999) * found.value * np.array([np.cos(angle), np.sin(angle), 0.0])
        assert pushed(robot, wall, at, force)
    worst = np.array(found.direction)
    assert pushed(robot, wall, at, 0.999 * found.value * worst)
    assert not pushed(robot, wall, at, (1.0 + 2.0 * GAP) * found.value * worst)


@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_friction_may_drop_by_the_margin_and_not_by_much_more(seed: int) -> None:
    rng, robot = np.random.default_rng(seed), named()
    wall, at = standing(robot, rng)
    drop = margin(robot, wall, at, "friction").value
    assume(drop > 0.01)
    assert pushed(robot, wall.slippery(0.999 * drop), at, np.zeros(3))
    if drop < 1.0 - 3.0 * GAP:
        assert not pushed(robot, wall.slippery(drop * (1.0 + 2.0 * GAP)), at, np.zeros(3))


@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_normals_may_turn_by_the_margin_and_not_by_much_more(seed: int) -> None:
    rng, robot = np.random.default_rng(seed), named()
    wall, at = standing(robot, rng)
    found = phase_margins(robot, wall, [at], ["normal"], {"normal": 1.4})[0]["normal"].value / KEPT
    least = min(math.atan(hold.friction) for hold in wall.holds)
    assume(0.005 < found < 0.97 * least)

    def narrower(angle: float) -> Wall:
        left = [math.tan(math.atan(hold.friction) - angle) / hold.friction for hold in wall.holds]
        return Wall(tuple(hold.slippery(1.0 - share) for hold, share in zip(wall.holds, left, strict=True)))

    assert pushed(robot, narrower(0.999 * found), at, np.zeros(3))
    assert not pushed(robot, narrower((1.0 + 2.5 * GAP) * found), at, np.zeros(3))


@pytest.mark.parametrize("planar", [True, False])
def test_forces_that_a_hold_gives_whichever_way_it_is_turned_are_those_inside_all_cones_turned_so_far(
    planar: bool,
) -> None:
    rng, angle = np.random.default_rng(5), 0.2
    plain = hold(0, 0, 10.0, friction=0.7, min_force=0.0, max_force=1e3)
    give = Give.of(plain, planar)
    f = give.normal + rng.uniform(-0.7, 0.7, (300, 3)) @ (give.tangents.T @ give.tangents)
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    if not planar:
        turn = 2.0 * np.pi * np.arange(64)[:, None] / 64
        axes = np.cos(turn) * give.tangents[0] + np.sin(turn) * give.tangents[1]
    normals = np.cos(angle) * give.normal + np.sin(angle) * np.cross(axes, give.normal)
    slide = np.arccos(f @ normals.T / np.linalg.norm(f, axis=1, keepdims=True)).max(axis=1)
    inside = give.turned(angle).excess(f) <= 0.0
    assert 30 < inside.sum() < 270
    assert (slide[inside] <= np.arctan(0.7) + 1e-9).all()
    assert (slide[~inside] >= np.arctan(0.7) - 2e-3).all()


@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_less_friction_has_no_greater_margins(seed: int) -> None:
    rng, robot = np.random.default_rng(seed), named()
    wall, at = standing(robot, rng)
    kinds: Sequence[MarginKind] = ("push", "mass", "center", "place", "normal")
    more, less = (phase_margins(robot, on, [at], kinds)[0] for on in (wall, wall.slippery(0.2)))
    for kind in kinds:
        assert less[kind].value <= more[kind].value * (1.0 + 2.0 * GAP) + 1e-9


def test_where_the_mass_is_about_to_fall_it_may_be_off_by_as_little_as_is_left() -> None:
    """The centre of mass is 0.01 mm inside the support, whose border is where some hold's force is at its greatest."""
    own = edge_plan().robots[0].phases[0].margins
    assert own["center"].value == pytest.approx(KEPT * 1.0e-5, rel=0.02)
    assert own["center"].direction == pytest.approx((1.0, 0.0, 0.0))
    assert own["place"].limb in ("right_front", "right_rear")
    assert AT_THE_EDGE.max_force == 3.6


def test_margins_are_the_least_of_all_instants() -> None:
    """A phase survives what each of its samples survives, and at the worst one hardly more."""
    plan = step_plan().robots[0]
    robot, phase = named(), plan.phases[1]
    wall = scenario_from_text(step_plan().scenario_text).build_wall()
    contacts = tuple(Contact(plan.limbs.index(c.limb), c.hold) for c in phase.contacts)
    for kind in ("push", "mass", "center", "normal"):
        singles = [
            Standing(contacts, Samples(*(part[i : i + 1] for part in (phase.time, phase.q, phase.v, phase.vd))))
            for i in range(0, len(phase.time), 4)
        ]
        values = [single[kind].value for single in phase_margins(robot, wall, singles, [kind])]
        assert phase.margins[kind].value <= min(values) * (1.0 + 1.1 * GAP)
        assert phase.margins[kind].value >= min(values) * (1.0 - 6.0 * GAP)  # what lies between may be less


def test_where_a_step_begins_at_the_forces_of_another_instant_it_does_not_end_there() -> None:
    """Two instants of one posture, accelerated there and back; either alone needs next to no friction."""
    wall, robot = load_scenario("wider").build_wall(), named()
    q = np.array([[1.017, 0.589, 2.317, -0.068, -1.315, 0.59, -2.02, -1.181, -1.051, 1.156, -1.807]])
    vd = np.array([[0.0, 0.01, -0.04, 0.12, -0.08, 0.08, 0.04, -0.01, 0.09, 0.08, -0.08]])
    contacts = tuple(Contact(limb, on) for limb, on in enumerate((37, 32, 30, 39)))

    def phase(*ways: float) -> Standing:
        rows = np.array(ways)[:, None]
        return Standing(contacts, Samples(np.arange(len(ways), dtype=float), rows**2 * q, 0.0 * rows * q, rows * vd))

    together, *alone = phase_margins(robot, wall, [phase(1.0, -1.0), phase(1.0), phase(-1.0)], ["friction"])
    least = min(margins["friction"].value for margins in alone)
    assert least * (1.0 - 1.1 * GAP) <= together["friction"].value <= least * (1.0 + 1.1 * GAP)


def test_margins_do_not_depend_on_which_other_phases_are_looked_at() -> None:
    again = with_margins(step_plan()).robots[0]
    assert [phase.margins for phase in again.phases] == [phase.margins for phase in step_plan().robots[0].phases]


def test_greater_margins_than_can_be_told_are_not_asked_for() -> None:
    raised = MinMargin(push=1.0).raised({"push": 0.5, "friction": 0.1})
    assert (raised.push, raised.friction, raised.mass) == (1.0, 0.1, 0.0)
    assert set(vars(raised)) == set(CAPS)
