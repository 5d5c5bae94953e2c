"""The cheapest way through layers of candidates, against trying every one."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from climber.choose import Candidates, Layer
from climber.objective import FLIP, Norm, Objective

ANGLE = 2
LENGTH = Objective("length", Norm(np.ones(5)), 1.0, 0.0, FLIP)
seeds = st.integers(0, 2**32 - 1)


def layer(q: object, branches: object, holding: tuple[int, ...] = (0, 1)) -> Layer:
    return Layer((), np.array(q, dtype=float), np.array(branches, dtype=np.int64), holding)


def random_candidates(rng: np.random.Generator) -> Candidates:
    """Two to five layers of one to four postures of a robot of three limbs."""
    layers = []
    for _ in range(rng.integers(2, 6)):
        count = int(rng.integers(1, 5))
        holding = tuple(int(i) for i in np.flatnonzero(rng.random(3) < 0.8))
        layers.append(layer(rng.uniform(-8, 8, (count, 5)), rng.integers(0, 2, (count, 3)), holding))
    result = Candidates(layers, ANGLE, LENGTH)
    for i, (one, two) in enumerate(itertools.pairwise(layers)):
        for a, b in itertools.product(range(len(one.q)), range(len(two.q))):
            if rng.random() < 0.25:
                result.barred.add((i, a, b))
    return result


def cost(candidates: Candidates, i: int, a: int, b: int) -> float:
    """Of one phase, step by step; inf where barred."""
    if (i, a, b) in candidates.barred:
        return np.inf
    here, there = candidates.layers[i], candidates.layers[i + 1]
    step = there.q[b] - here.q[a]
    turn = (step[ANGLE] + np.pi) % (2 * np.pi) - np.pi
    rest = np.delete(step, ANGLE)
    flips = sum(int(here.branches[a, limb] != there.branches[b, limb]) for limb in there.holding)
    return float(np.sqrt(turn**2 + (rest**2).sum()) + FLIP * flips)


def total(candidates: Candidates, way: tuple[int, ...] | list[int]) -> float:
    return sum(cost(candidates, i, a, b) for i, (a, b) in enumerate(itertools.pairwise(way)))


@settings(max_examples=200, deadline=None)
@given(seeds)
def test_best_is_the_cheapest_of_all_ways_or_none_if_all_are_barred(seed: int) -> None:
    candidates = random_candidates(np.random.default_rng(seed))
    ways = itertools.product(*(range(len(one.q)) for one in candidates.layers))
    least = min(total(candidates, way) for way in ways)
    best = candidates.best()
    if np.isinf(least):
        assert best is None
    else:
        assert best is not None
        assert total(candidates, best) == pytest.approx(least, abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_costs_are_those_of_each_pair(seed: int) -> None:
    candidates = random_candidates(np.random.default_rng(seed))
    for i in range(len(candidates.layers) - 1):
        costs = candidates.costs(i)
        for a, b in itertools.product(*map(range, costs.shape)):
            assert costs[a, b] == pytest.approx(cost(candidates, i, a, b), abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_barring_the_best_again_and_again_goes_through_ways_of_no_less_cost_until_none_is_left(seed: int) -> None:
    candidates = random_candidates(np.random.default_rng(seed))
    before, seen = 0.0, set()
    while (best := candidates.best()) is not None:
        now = total(candidates, best)
        assert now >= before - 1e-9 and tuple(best) not in seen
        before = now
        seen.add(tuple(best))
        candidates.barred.add((0, best[0], best[1]))
    phases = itertools.product(range(len(candidates.layers[0].q)), range(len(candidates.layers[1].q)))
    ways = itertools.product(*(range(len(one.q)) for one in candidates.layers))
    assert all(np.isinf(total(candidates, way)) for way in ways)
    assert len(seen) <= len(list(phases))


def test_flip_of_a_limb_that_holds_counts_and_of_one_that_swings_does_not() -> None:
    zero = np.zeros((1, 5))
    for holding, expected in (((0, 1, 2), 2 * FLIP), ((0, 2), FLIP), ((), 0.0)):
        candidates = Candidates([layer(zero, [[0, 0, 0]]), layer(zero, [[1, 1, 0]], holding)], ANGLE, LENGTH)
        assert candidates.costs(0)[0, 0] == pytest.approx(expected)


def test_whole_turns_of_the_pelvis_cost_nothing() -> None:
    q = np.zeros((1, 5))
    turned = q.copy()
    turned[0, ANGLE] = 6 * np.pi + 0.1
    assert Candidates([layer(q, [[0]], (0,)), layer(turned, [[0]], (0,))], ANGLE, LENGTH).costs(0)[
        0, 0
    ] == pytest.approx(0.1)


def test_one_layer_needs_no_phase_and_an_empty_one_lets_none_through() -> None:
    one, none = layer(np.zeros((3, 5)), np.zeros((3, 2))), layer(np.zeros((0, 5)), np.zeros((0, 2)))
    assert Candidates([one], ANGLE, LENGTH).best() == [0]
    for layers in ([none], [none, one], [one, none], [one, none, one]):
        assert Candidates(layers, ANGLE, LENGTH).best() is None


@settings(max_examples=100, deadline=None)
@given(seeds)
def test_dead_end_is_the_first_layer_that_nothing_leads_on_from(seed: int) -> None:
    candidates = random_candidates(np.random.default_rng(seed))
    if candidates.best() is not None:
        with pytest.raises(ValueError, match="there is a way"):
            candidates.dead_end()
        return
    i, reached = candidates.dead_end()
    before = itertools.product(*(range(len(one.q)) for one in candidates.layers[: i + 1]))
    assert set(reached) == {way[-1] for way in before if np.isfinite(total(candidates, way))}
    assert len(reached) and np.isinf(candidates.costs(i)[reached]).all()


def test_barring_a_phase_bars_all_its_pairs() -> None:
    candidates = Candidates([layer(np.zeros((n, 5)), np.zeros((n, 2))) for n in (2, 3, 1)], ANGLE, LENGTH)
    candidates.bar_phase(0)
    assert np.isinf(candidates.costs(0)).all() and np.isfinite(candidates.costs(1)).all()
    assert candidates.best() is None and candidates.dead_end()[0] == 0
