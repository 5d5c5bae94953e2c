"""Time scaling: against Drake's Toppra, against cases solved by hand, and against itself."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.multibody.optimization import Toppra
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces
from pydrake.trajectories import PiecewisePolynomial

from climber.programs.path_dynamics import FASTEST, PathDynamics
from climber.programs.speed_profile import SpeedProfile, TimeLaw
from climber.programs.time_scaling import TimeScaling, TimeScalingProgram
from climber.stance import Vector

G = 9.81


def free(**given: Any) -> PathDynamics:
    """A path without contacts, motors or limits, but for what is given."""
    x = given["x"]
    N = len(x)
    first, second = (given.get(name, np.zeros((N, 1))) for name in ("first", "second"))
    E = given.get("E", np.zeros((N, 0, 0)))
    n, limited = E.shape[2], first.shape[1]
    fields: dict[str, Any] = {
        "E": E,
        "e": np.zeros((3, N, E.shape[1])),
        "A": np.zeros((N, 0, n)),
        "c": np.zeros((3, N, 0)),
        "first": first,
        "second": second,
        "speed": np.full(limited, np.inf),
        "acceleration": np.full(limited, np.inf),
        "jerk": np.full(limited, np.inf),
        "torque": np.zeros((N, 0)),
        "rows": np.zeros((0, n)),
        "most": np.zeros((N, 0)),
        "cones": np.zeros((0, 3, n)),
        "tops": np.zeros((N, 0, 3)),
        "names": ([], [], [f"joint {j}" for j in range(limited)]),
    }
    return PathDynamics(**{**fields, **given})


def solved(dynamics: PathDynamics, profile: SpeedProfile, **options: Any) -> TimeScaling:
    result = TimeScalingProgram(dynamics, profile, **options).solve()
    assert result is not None
    return result


def rest_to_rest(intervals: int, length: float = 1.0) -> tuple[SpeedProfile, Vector, Vector]:
    """A piecewise linear profile, the middles of its intervals, and its knots."""
    nodes = np.linspace(0.0, length, intervals + 1)
    return SpeedProfile(length, intervals, degree=1), (nodes[:-1] + nodes[1:]) / 2, nodes


# --- a fixed-base arm, against Toppra --------------------------------------------------------------------------------

ARM = """<robot name="arm">
  <link name="base"/>
  <joint name="weld" type="fixed"><parent link="world"/><child link="base"/></joint>
  {links}
</robot>"""
LINK = """
  <joint name="j{i}" type="revolute"><parent link="{parent}"/><child link="link{i}"/>
    <origin xyz="{at} 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="{speed}" effort="9"/><dynamics damping="{damping}"/></joint>
  <transmission><type>transmission_interface/SimpleTransmission</type><joint name="j{i}"/><actuator name="j{i}"/>
  </transmission>
  <link name="link{i}"><inertial><origin xyz="0.15 0 0"/><mass value="{mass}"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
TORQUES = np.array([9.0, 5.0, 2.0])


def arm(damping: float = 0.0, speed: float = 100.0) -> MultibodyPlant:
    """Three links in the plane that gravity acts in, on a steep slab."""
    links = "".join(
        LINK.format(
            i=i,
            parent=f"link{i - 1}" if i else "base",
            at=0.3 if i else 0,
            mass=1 - 0.2 * i,
            damping=damping,
            speed=speed,
        )
        for i in range(3)
    )
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(ARM.format(links=links), "urdf")
    plant.mutable_gravity_field().set_gravity_vector([0.0, -4.0, 0.0])
    plant.Finalize()
    return plant


def arm_path(seed: int) -> PiecewisePolynomial:
    rng = np.random.default_rng(seed)
    knots = np.cumsum(rng.normal(0.0, 0.5, (3, 4)), axis=1)
    return PiecewisePolynomial.CubicWithContinuousSecondDerivatives(np.linspace(0.0, 1.0, 4), knots, False)


def arm_dynamics(plant: MultibodyPlant, path: PiecewisePolynomial, x: Vector) -> PathDynamics:
    """The path's dynamics by Drake's inverse dynamics: at rest, at unit speed, and for unit acceleration."""
    context = plant.CreateDefaultContext()
    q, first, second = (np.stack([np.ravel(path.EvalDerivative(at, order)) for at in x]) for order in (0, 1, 2))
    c, damping = np.zeros((3, len(x), 3)), np.zeros((len(x), 3))
    for k in range(len(x)):

        def needed(v: Vector, vd: Vector, k: int = k) -> Vector:
            plant.SetPositions(context, q[k])
            plant.SetVelocities(context, v)
            forces = MultibodyForces(plant)
            plant.CalcForceElementsContribution(context, forces)
            return np.asarray(plant.CalcInverseDynamics(context, vd, forces))

        rest = needed(0 * first[k], 0 * first[k])
        damping[k] = (needed(first[k], 0 * first[k]) - needed(-first[k], 0 * first[k])) / 2
        c[0, k] = rest
        c[1, k] = needed(first[k], second[k]) - rest - damping[k]
        c[2, k] = needed(0 * first[k], first[k]) - rest
    return free(
        x=x,
        A=np.zeros((len(x), 3, 0)),
        c=c,
        torque=np.tile(TORQUES, (len(x), 1)),
        first=first,
        second=second,
        names=([], ["j0", "j1", "j2"], ["j0", "j1", "j2"]),
        damping=damping if damping.any() else None,
    )


def toppra(plant: MultibodyPlant, path: PiecewisePolynomial, nodes: Vector, **limits: Vector) -> float:
    program = Toppra(path, plant, nodes)
    program.AddJointTorqueLimit(-TORQUES, TORQUES)
    if "speed" in limits:
        program.AddJointVelocityLimit(-limits["speed"], limits["speed"])
    if "acceleration" in limits:
        program.AddJointAccelerationLimit(-limits["acceleration"], limits["acceleration"])
    return float(program.SolvePathParameterization().end_time())


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("limits", [{}, {"speed": np.full(3, 2.0), "acceleration": np.full(3, 12.0)}])
def test_an_arm_with_torque_limits_is_as_fast_as_toppra_says(seed: int, limits: dict[str, Vector]) -> None:
    plant, path = arm(), arm_path(seed)
    profile, middles, nodes = rest_to_rest(200)
    dynamics = replace(arm_dynamics(plant, path, middles), **limits)
    duration = solved(dynamics, profile, nodes=nodes, rest=True).duration
    assert duration == pytest.approx(toppra(plant, path, nodes, **limits), rel=0.01)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**16), damping=st.floats(0.05, 0.5))
def test_a_timing_with_damped_joints_keeps_to_torques_that_count_the_damping(seed: int, damping: float) -> None:
    plant, path = arm(damping), arm_path(seed)
    profile, middles, nodes = rest_to_rest(40)
    dynamics = arm_dynamics(plant, path, middles)
    scaling = solved(dynamics, profile, nodes=nodes, rest=True)
    b, a = scaling.b[:, None], scaling.a[:, None]
    assert dynamics.damping is not None
    torque = dynamics.c[0] + dynamics.c[1] * b + dynamics.c[2] * a + dynamics.damping * np.sqrt(b)
    assert (np.abs(torque) <= TORQUES + 1e-5).all()
    undamped = solved(replace(dynamics, damping=None), profile, nodes=nodes, rest=True)
    # To brake, damping would help; that help is not counted, so a damped motion is never the faster one.
    assert undamped.duration <= scaling.duration * (1 + 1e-4)


# --- a point mass on contacts ----------------------------------------------------------------------------------------


def sliding(x: Vector, friction: float, distance: float = 1.0, mass: float = 2.0) -> PathDynamics:
    """A mass carried along a straight horizontal path by one frictional contact with level ground, in the plane."""
    half = np.arctan(friction)
    edges = np.array([[np.sin(half), -np.sin(half)], [np.cos(half), np.cos(half)]])
    e = np.zeros((3, len(x), 2))
    e[0, :, 1], e[2, :, 0] = mass * G, mass * distance
    return free(
        x=x,
        E=np.tile(edges, (len(x), 1, 1)),
        e=e,
        A=np.zeros((len(x), 0, 2)),
        first=np.full((len(x), 1), distance),
        rows=-np.eye(2),
        most=np.zeros((len(x), 2)),
        names=(["friction foot", "friction foot"], [], ["slide"]),
    )


@pytest.mark.parametrize("friction", [0.1, 0.6, 1.5])
@pytest.mark.parametrize("distance", [0.5, 3.0])
def test_a_mass_on_one_contact_speeds_up_and_brakes_as_hard_as_friction_allows(
    friction: float, distance: float
) -> None:
    """Half the way at friction times g, half at as much against it: T = 2 sqrt(d / (mu g))."""
    profile, middles, nodes = rest_to_rest(40)
    scaling = solved(sliding(middles, friction, distance), profile, nodes=nodes, rest=True)
    assert scaling.duration == pytest.approx(2 * np.sqrt(distance / (friction * G)), rel=1e-4)
    most = friction * G / distance
    assert scaling.a == pytest.approx(np.where(middles < 0.5, most, -most), rel=1e-3)
    assert scaling.b == pytest.approx(2 * most * np.minimum(middles, 1 - middles), rel=1e-3)
    switch = 19, 20  # the only places at which to be a little slower costs nothing
    assert {scaling.active[i] for i in range(40) if i not in switch} == {frozenset({"friction foot"})}


def test_a_speed_limit_cuts_the_top_off() -> None:
    profile, middles, nodes = rest_to_rest(100)
    dynamics = replace(sliding(middles, 0.5, 2.0), speed=np.array([1.5]))
    scaling = solved(dynamics, profile, nodes=nodes, rest=True)
    # The triangle of speed with its top cut off: v / a to speed up and brake, the rest at v.
    assert scaling.duration == pytest.approx(2.0 / 1.5 + 1.5 / (0.5 * G), rel=1e-3)
    assert scaling.active[50] == {"speed slide"} and scaling.active[0] == {"friction foot"}


def circling(x: Vector, friction: float, radius: float, edges: int = 0, across: bool = False) -> PathDynamics:
    """A mass carried round a level circle by one contact with level ground; in 3D, by a cone or by a pyramid.

    Args:
        x: Places, the angle over a full turn.
        friction: Coefficient.
        radius: Of the circle [m].
        edges: Of the pyramid; 0 for the cone itself.
        across: Whether the pyramid is circumscribed about the cone rather than inscribed.
    """
    angle, rate = 2 * np.pi * x, 2 * np.pi * radius
    along = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    inward = -np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    e = np.stack([np.tile([0.0, 0.0, G], (len(x), 1)), 2 * np.pi * rate * inward, rate * along])
    forces: dict[str, Any] = {"cones": np.array([[[0.0, 0.0, -friction], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])}
    forces["tops"] = np.zeros((len(x), 1, 3))
    if edges:
        normals = 2 * np.pi * (np.arange(edges) + 0.5) / edges
        size = friction * (1.0 if across else np.cos(np.pi / edges))
        rows = np.column_stack([np.cos(normals), np.sin(normals), np.full(edges, -size)])
        forces = {"rows": rows, "most": np.zeros((len(x), edges))}
    return free(
        x=x,
        E=np.tile(np.eye(3), (len(x), 1, 1)),
        e=e,
        A=np.zeros((len(x), 0, 3)),
        first=np.full((len(x), 1), rate),
        names=(["friction foot"] * max(1, edges), [], ["way"]),
        **forces,
    )


def test_round_cones_and_fine_pyramids_agree_from_both_sides() -> None:
    profile, middles, nodes = rest_to_rest(60)

    def duration(edges: int, across: bool = False) -> float:
        return solved(circling(middles, 0.6, 0.4, edges, across), profile, nodes=nodes, rest=True).duration

    exact = duration(0)
    for edges in (4, 8, 64):
        assert duration(edges, across=True) <= exact + 1e-5 and exact - 1e-5 <= duration(edges)
        # A pyramid's forces are between those of the cones that it holds and is held in.
        slower = np.cos(np.pi / edges) ** -0.5
        assert duration(edges) <= exact * slower + 1e-5 and exact / slower <= duration(edges, across=True) + 1e-5
    assert duration(64) == pytest.approx(exact, rel=2e-3)


def test_on_a_circle_friction_holds_the_mass_in() -> None:
    """At full speed all of the friction points inwards: v = sqrt(mu g r)."""
    profile, middles, nodes = rest_to_rest(100)
    scaling = solved(circling(middles, 0.6, 0.4), profile, nodes=nodes, rest=True)
    fastest = np.sqrt(0.6 * G * 0.4)
    speeds = 2 * np.pi * 0.4 * np.sqrt(scaling.b)
    assert speeds.max() <= fastest * (1 + 1e-4)
    assert speeds.max() == pytest.approx(fastest, rel=0.01)
    assert set(scaling.active) == {frozenset({"friction foot"})}


@settings(max_examples=40, deadline=None)
@given(friction=st.floats(0.05, 2.0), radius=st.floats(0.05, 2.0), planar=st.booleans(), edges=st.integers(3, 9))
def test_half_the_friction_is_never_faster(friction: float, radius: float, planar: bool, edges: int) -> None:
    profile, middles, nodes = rest_to_rest(30)

    def duration(mu: float) -> float:
        dynamics = sliding(middles, mu, radius) if planar else circling(middles, mu, radius, edges)
        return solved(dynamics, profile, nodes=nodes, rest=True).duration

    assert duration(friction / 2) >= duration(friction) * (1 - 1e-5)


# --- smooth profiles and jerk ----------------------------------------------------------------------------------------


def winding(seed: int, N: int) -> tuple[SpeedProfile, PathDynamics]:
    """Three joints along a random smooth path whose ends are at rest with any speed along x; rate limits only."""
    rng = np.random.default_rng(seed)
    x = np.linspace(0.0, 1.0, N)
    # sigma = 3 x^2 - 2 x^3 stretched so that two derivatives vanish: the minimum-jerk law.
    law, rate, bend = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2, 60 * x * (1 - x) * (1 - 2 * x)
    shape = np.polynomial.Polynomial
    ways = [shape(rng.normal(0.0, 1.0, 5)) for _ in range(3)]
    first = np.stack([way.deriv()(law) * rate for way in ways], axis=1)
    second = np.stack([way.deriv(2)(law) * rate**2 + way.deriv()(law) * bend for way in ways], axis=1)
    limits = {"speed": np.full(3, 2.0), "acceleration": np.full(3, 15.0), "jerk": np.full(3, 200.0)}
    return SpeedProfile(1.0, (N - 1) // 2), free(x=x, first=first, second=second, **limits)


def accelerations(dynamics: PathDynamics, scaling: TimeScaling) -> Vector:
    result: Vector = dynamics.second * scaling.b[:, None] + dynamics.first * scaling.a[:, None]
    return result


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**16))
def test_every_round_is_feasible_and_none_is_slower_than_the_one_before(seed: int) -> None:
    profile, dynamics = winding(seed, 41)
    program = TimeScalingProgram(dynamics, profile)
    reference, last = np.full(41, dynamics.paced()), np.inf
    law = TimeLaw(profile, np.full(profile.size, dynamics.paced()))
    for _ in range(4):
        scaling = program.solve_at(reference)
        assert scaling is not None
        speeds, changes = (
            np.abs(dynamics.first) * np.sqrt(scaling.b)[:, None],
            np.diff(accelerations(dynamics, scaling), axis=0),
        )
        assert (speeds <= 2.0 * (1 + 1e-5)).all()
        assert (np.abs(accelerations(dynamics, scaling)) <= 15.0 * (1 + 1e-5)).all()
        steps = np.diff(dynamics.x) / np.sqrt((scaling.b[:-1] + scaling.b[1:]) / 2)
        assert (np.abs(changes) <= 200.0 * steps[:, None] * (1 + 1e-4)).all()
        assert scaling.duration <= last * (1 + 1e-5)
        reference, last = np.maximum(scaling.b, 1e-6), scaling.duration
    assert last <= law.duration * (1 + 1e-5)
    best = program.solve()
    assert best is not None and best.duration <= 1.03 * last


def test_a_tighter_jerk_limit_is_slower_and_is_told_as_active() -> None:
    profile, dynamics = winding(3, 41)
    durations = [solved(replace(dynamics, jerk=np.full(3, jerk)), profile).duration for jerk in (np.inf, 400.0, 100.0)]
    assert durations == sorted(durations) and durations[0] < 0.95 * durations[2]
    active = frozenset().union(*solved(replace(dynamics, jerk=np.full(3, 100.0)), profile).active)
    assert any(name.startswith("jerk joint") for name in active)
    without = frozenset().union(*solved(replace(dynamics, jerk=np.full(3, np.inf)), profile).active)
    assert not any(name.startswith("jerk") for name in without)


def test_a_time_law_passes_where_its_profile_says_when_it_says() -> None:
    """Against integration by small steps, and its own derivatives."""
    profile = SpeedProfile(0.7, 9)
    law = TimeLaw(profile, np.random.default_rng(1).uniform(0.2, 3.0, profile.size))
    fine = np.linspace(0.0, 0.7, 200_001)
    slow = 1 / np.sqrt(profile.spline(law.coefficients)(fine))
    time = np.concatenate([[0.0], np.cumsum((slow[1:] + slow[:-1]) / 2 * np.diff(fine))])
    assert law.duration == pytest.approx(time[-1], abs=1e-9)
    instants = np.linspace(0.0, law.duration, 101)
    x, rate, acceleration = law.at(instants)
    assert x == pytest.approx(np.interp(instants, time, fine), abs=1e-8)
    assert law.time(x) == pytest.approx(instants, abs=1e-12)
    h = 1e-5
    before, after = law.at(instants[1:-1] - h), law.at(instants[1:-1] + h)
    assert rate[1:-1] == pytest.approx((after[0] - before[0]) / (2 * h), abs=1e-7)
    assert acceleration[1:-1] == pytest.approx((after[1] - before[1]) / (2 * h), abs=1e-6)
    assert law.slowed(3.0).duration == pytest.approx(3 * law.duration)


def test_a_path_that_nothing_limits_is_run_at_the_greatest_speed_that_is_looked_for() -> None:
    profile, middles, nodes = rest_to_rest(10)
    scaling = solved(free(x=middles), profile, nodes=nodes)
    assert scaling.b == pytest.approx(FASTEST, rel=1e-3)


def test_where_the_mass_cannot_be_held_there_is_no_timing() -> None:
    profile, middles, nodes = rest_to_rest(10)
    steep = sliding(middles, 0.3)
    e = steep.e.copy()
    e[0, 4, 1] = -2.0 * G  # at one place the ground would have to pull
    assert TimeScalingProgram(replace(steep, e=e), profile, nodes, rest=True).solve() is None


def test_constraints_have_names_and_the_program_is_there_before_it_is_solved() -> None:
    profile, middles, nodes = rest_to_rest(10)
    program = TimeScalingProgram(circling(middles, 0.6, 0.4), profile, nodes, rest=True)
    assert set(program.constraints) == {
        "balance",
        "rest",
        "force",
        "cone",
        "speed",
        "positive",
        "speed at the nodes",
        "time from node to node",
    }
    assert program.num_variables == 11 + 10 + 11 + 10 * 3
    assert program.constraints["cone"] == slice(0, 30)
