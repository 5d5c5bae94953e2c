"""Motions along paths: velocities and accelerations are the derivatives, contacts stand still, rates keep to limits."""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
import pytest
from pydrake.multibody.tree import JacobianWrtVariable
from robots import every_star, robot, standing

from climber.curve import Curve, smooth
from climber.manifold import Manifold
from climber.path import Search, find_path, flips
from climber.timing import PEAK, PacedPath, Samples, joined, rates

QUICK = Search(iterations=40, nodes=40, checks=40)


@cache
def motions(model: str) -> list[tuple[Manifold, Curve]]:
    """Curves along paths, in plain and in rooted charts, with all limbs holding and with one in the air."""
    result = []
    limbs = len(robot(model).limbs)
    for seed in range(3):
        here = standing(model, seed, (seed % limbs,) if seed % 2 else ())
        q = here.postures(np.random.default_rng(seed), 30)
        for number in (0, 1):
            pairs = [pair for pair in itertools.combinations(q, 2) if len(flips(here.manifold, *pair)) == number]
            found = (find_path(here.manifold, *pair, np.random.default_rng(0), QUICK) for pair in pairs[:10])
            for leg in next((legs for legs in found if legs is not None), []):
                curve = smooth(here.manifold, leg.chart, leg.u)
                if curve is not None:
                    result.append((here.manifold, curve))
    return result


def fastest(path: PacedPath, count: int = 1001) -> Samples:
    """The leg run so that sigma is never faster than time."""
    return path.samples(PEAK * path.length, count)


@every_star
def test_sample_has_plain_and_rooted_charts_of_all_limbs_and_all_but_one(model: str) -> None:
    charts = [curve.chart for _, curve in motions(model)]
    assert {getattr(chart, "root", None) is None for chart in charts} == {True, False}
    assert {len(chart.points) for chart in charts} == {len(robot(model).limbs), len(robot(model).limbs) - 1}


@every_star
def test_velocities_and_accelerations_of_a_configuration_follow_from_its_coordinates(model: str) -> None:
    for _, curve in motions(model):
        s, h = np.linspace(0.05, 0.95, 19), 1e-5
        q = curve.q(s)
        v, vd = rates(curve.chart, q, curve.du(s), curve.ddu(s))
        assert vd is not None
        before, after = curve.q(s - h), curve.q(s + h)
        by_differences = robot(model).v_of(q, (after - before) / (2 * h))
        assert v == pytest.approx(by_differences, abs=1e-5 * (1 + np.abs(v).max() ** 2))
        change = (rates(curve.chart, after, curve.du(s + h))[0] - rates(curve.chart, before, curve.du(s - h))[0]) / (
            2 * h
        )
        assert vd == pytest.approx(change, abs=1e-5 * (1 + np.abs(vd).max() ** 1.5))
        assert rates(curve.chart, q, curve.du(s))[1] is None


@every_star
def test_v_is_the_derivative_of_q_and_vd_that_of_v(model: str) -> None:
    for _, curve in motions(model):
        path = PacedPath(curve)
        sigma, h = np.linspace(0.02, 0.98, 25) * path.length, 1e-6 * path.length
        rate, acceleration = np.full(25, 0.8), np.full(25, 0.3)
        # Along sigma(t) = sigma + 0.8 t + 0.15 t^2 from t = -h to h.
        moments = [
            path.at(sigma + rate * t + acceleration * t**2 / 2, rate + acceleration * t, acceleration)
            for t in (-h, 0, h)
        ]
        (q0, v0, _), (q, v, vd), (q1, v1, _) = moments
        assert v == pytest.approx(robot(model).v_of(q, (q1 - q0) / (2 * h)), abs=1e-6 * (1 + np.abs(v).max()))
        assert vd == pytest.approx((v1 - v0) / (2 * h), abs=1e-5 * (1 + np.abs(vd).max()))


@every_star
def test_samples_are_instants_of_one_motion_in_time(model: str) -> None:
    for _, curve in motions(model):
        samples = fastest(PacedPath(curve), 4001)
        dt = samples.time[1]
        inner = slice(1, -1)
        v = robot(model).v_of(samples.q[inner], (samples.q[2:] - samples.q[:-2]) / (2 * dt))
        vd = (samples.v[2:] - samples.v[:-2]) / (2 * dt)
        assert v == pytest.approx(samples.v[inner], abs=1e-3 * (1 + np.abs(samples.v).max()))
        # A pace bends at its knots, where differences straddle two pieces.
        off = np.abs(vd - samples.vd[inner]).max(axis=1)
        assert np.quantile(off, 0.97) < 1e-3 * (1 + np.abs(samples.vd).max())


@every_star
def test_motion_is_at_rest_at_both_ends_and_goes_from_one_end_of_the_curve_to_the_other(model: str) -> None:
    for _, curve in motions(model):
        samples = PacedPath(curve).samples(2.5, 251)
        assert samples.time == pytest.approx(np.linspace(0.0, 2.5, 251), abs=1e-12)
        ends = curve.q(np.array([0.0, 1.0]))
        assert samples.q[[0, -1]] == pytest.approx(ends, abs=1e-9)
        for rest in (samples.v, samples.vd):
            assert np.abs(rest[[0, -1]]).max() < 1e-9


@every_star
def test_feet_that_hold_stand_still_by_drakes_jacobians(model: str) -> None:
    machine = robot(model)
    plant, context, world = machine.plant, machine.context(), machine.plant.world_frame()
    for manifold, curve in motions(model):
        samples = fastest(PacedPath(curve), 21)
        for q, v, vd in zip(samples.q, samples.v, samples.vd, strict=True):
            plant.SetPositions(context, q)
            plant.SetVelocities(context, v)
            for i, point in manifold.points.items():
                foot = plant.GetFrameByName(machine.limbs[i].foot)
                J = plant.CalcJacobianTranslationalVelocity(
                    context, JacobianWrtVariable.kV, foot, np.zeros(3), world, world
                )
                bias = plant.CalcBiasTranslationalAcceleration(
                    context, JacobianWrtVariable.kV, foot, np.zeros(3), world, world
                )
                position = foot.CalcPoseInWorld(context).translation()
                assert position == pytest.approx(point, abs=1e-12)
                assert np.abs(J @ v).max() < 1e-11 * (1 + np.abs(v).max())
                assert np.abs(J @ vd + bias.reshape(-1)).max() < 1e-6 * (1 + np.abs(vd).max())


@every_star
def test_joint_rates_keep_to_their_limits_at_full_pace(model: str) -> None:
    worst = []
    for _, curve in motions(model):
        samples = fastest(PacedPath(curve), 4001)
        shares = [np.abs(samples.v[:, limb.v]) / limb.velocity for limb in robot(model).limbs]
        worst.append(max(share.max() for share in shares))
        base = np.abs(samples.v[:, robot(model).base_v]).max()
        assert base <= 1.001
    assert max(worst) <= 1.001
    assert np.median(worst) > 0.3  # and use them


@every_star
def test_twice_the_duration_halves_velocities_and_quarters_accelerations(model: str) -> None:
    _, curve = motions(model)[0]
    path = PacedPath(curve)
    once, twice = path.samples(1.0, 101), path.samples(2.0, 101)
    assert twice.q == pytest.approx(once.q, abs=1e-12)
    assert twice.v == pytest.approx(once.v / 2, abs=1e-12)
    assert twice.vd == pytest.approx(once.vd / 4, abs=1e-9 * (1 + np.abs(once.vd).max()))


def test_peak_is_the_greatest_rate_of_the_law() -> None:
    tau = np.linspace(0, 1, 10001)
    assert np.gradient(tau**3 * (10 - 15 * tau + 6 * tau**2), tau).max() == pytest.approx(PEAK, abs=1e-6)


def test_curve_of_no_length_takes_next_to_no_time_and_stays() -> None:
    manifold, curve = motions("quadruped")[0]
    still = smooth(manifold, curve.chart, np.array([curve.u(np.zeros(1))[0]] * 2))
    assert still is not None
    path = PacedPath(still)
    samples = path.samples(0.1, 11)
    assert path.length < 1e-6
    assert np.ptp(samples.q, axis=0).max() < 1e-9 and np.abs(samples.v).max() < 1e-9 and np.abs(samples.vd).max() < 1e-6


def test_pieces_run_one_after_the_other_without_the_instants_they_share() -> None:
    paths = [PacedPath(curve) for _, curve in motions("quadruped")[:3]]
    pieces = [path.samples(duration, 51) for path, duration in zip(paths, (1.0, 2.0, 0.5), strict=True)]
    whole = joined(pieces)
    assert len(whole.time) == 151 and whole.time[-1] == pytest.approx(3.5)
    assert (np.diff(whole.time) > 0).all()
    for name in ("q", "v", "vd"):
        parts = [getattr(piece, name) for piece in pieces]
        assert np.array_equal(getattr(whole, name), np.concatenate([parts[0], parts[1][1:], parts[2][1:]]))
    assert np.array_equal(joined(pieces[:1]).q, pieces[0].q)
