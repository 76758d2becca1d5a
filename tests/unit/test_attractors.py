"""Grouping of responses, against a straightforward version that compares them one by one."""

import math

import numpy as np
import pytest
from tests.builders.attractors import attractors_of_scenes
from tests.oracles.section_points import complex_points, orbit_distance

from gapsweep.model.structure import Structure
from gapsweep.response.attractors import NONE, Grouping
from gapsweep.response.result import Response, ResponseClass, Responses
from gapsweep.response.section import own_neighbours, unit_of
from gapsweep.status import Status

OMEGA = 7.0


# --- straightforward ------------------------------------------------------------------------------


def points(response, omega):
    return complex_points(response.section, omega)


def same(a, b, omega):
    if a.response_class is not b.response_class:
        return False
    p, q = points(a, omega), points(b, omega)
    if a.response_class is ResponseClass.PERIODIC:
        reach = max(abs(a.x_max), abs(a.x_min))
        rattles = max(a.lyapunov_error, b.lyapunov_error) > 0.0
        noise = 4.0 * max((n for n in (a.noise, b.noise) if math.isfinite(n)), default=0.0)
        return orbit_distance(p, q) <= max((0.1 if rattles else 1e-3) * reach, noise)
    distances = np.abs(p[:, None] - q[None, :])
    nearest = max(np.quantile(distances.min(axis=axis), 0.8) for axis in (0, 1))
    extent = max(np.ptp(part) for cloud in (p, q) for part in (cloud.real, cloud.imag))
    return nearest <= 0.25 * float(extent) or own_share(p, q) < 0.75


def own_share(p, q):
    """Share of the points of two samples whose nearest neighbour is in the same sample."""
    n_own = 0
    for ours, theirs in ((p, q), (q, p)):
        for i, point in enumerate(ours):
            own = min(abs(point - other) for k, other in enumerate(ours) if k != i)
            n_own += own < min(abs(point - other) for other in theirs)
    return n_own / (len(p) + len(q))


def mirror(response, firsts):
    reach = max(abs(response.x_max), abs(response.x_min))
    chaotic = response.response_class is ResponseClass.CHAOTIC
    close = (0.25 if chaotic else 2e-3) * reach
    image = np.sort(-np.array(response.extrema))
    for number, other in enumerate(firsts):
        if other.response_class is not response.response_class:
            continue
        ends = abs(other.x_max + response.x_min), abs(other.x_min + response.x_max)
        if max(ends) > close or other.period_multiple != response.period_multiple:
            continue
        extrema = np.sort(other.extrema)
        if chaotic or (extrema.size == image.size and np.all(np.abs(extrema - image) <= close)):
            return number
    return NONE


def straightforward(responses, omega, symmetric, counted):
    """Members, mirror image, counted members and counted starts of each attractor."""
    groups = []
    for i, response in enumerate(responses):
        if not response.section or response.response_class > ResponseClass.CHAOTIC:
            continue
        own = next((g for g in groups if same(responses[g[0]], response, omega)), None)
        if own is None:
            groups.append([i])
        else:
            own.append(i)

    def rank(group):
        first = responses[group[0]]
        return round(first.x_max, 9), round(first.x_min, 9), first.period_multiple

    groups.sort(key=rank)
    firsts = [responses[group[0]] for group in groups]
    return [
        (
            tuple(group),
            mirror(responses[group[0]], firsts) if symmetric else NONE,
            sum(counted[i] for i in group),
            sum(counted),
        )
        for group in groups
    ]


# --- random responses -----------------------------------------------------------------------------


def orbits(rng, n_families):
    """Shapes that responses are copies of: states, extrema, period multiple; and mirror images."""
    found = []
    for _ in range(n_families):
        n = int(rng.choice([1, 1, 2, 3, 6]))
        states = rng.normal(size=(n, 2)) * [1e-3, 1e-3 * 2.0 * math.pi * OMEGA]
        extrema = rng.normal(size=2 * n) * 1e-3
        found += [(states, extrema, n), (-states, -extrema, n)]
        # One that is near, and one that is its own image.
        found.append((states * (1.0 + rng.choice([5e-4, 2e-3, 0.05])), extrema, n))
        found.append((states, np.concatenate([extrema, -extrema]), n))
    return found


def random_response(rng, families):
    kind = rng.choice(4, p=[0.7, 0.15, 0.1, 0.05])
    costs = {"status": Status.OK, "noise": float(rng.choice([np.nan, 1e-12, 1e-5]))}
    if kind == ResponseClass.FAILED:
        return Response(status=Status.DIVERGED)
    if kind == ResponseClass.PERIODIC:
        states, extrema, n = families[rng.integers(len(families))]
        states = np.roll(states, rng.integers(n), axis=0)
        scatter = rng.choice([0.0, 1e-9, 3e-4, 9e-4]) * rng.normal(size=states.shape)
        states = states * (1.0 + scatter)
        error = float(rng.choice([0.0, 0.0, 0.0, 1e-3, np.nan]))
    else:
        size, place = rng.integers(1, 4), rng.choice([-1.0, 1.0])
        count = int(rng.choice([32, 32, 20]))
        states = (rng.normal(size=(count, 2)) + place) * [1e-3 * size, 4e-2 * size]
        extrema, n, error = rng.normal(size=5) * 1e-3 * size + place * 1e-3, 0, 0.1
    return Response(
        response_class=ResponseClass(kind),
        period_multiple=n,
        extrema=tuple(extrema.tolist()),
        x_max=float(extrema.max()),
        x_min=float(extrema.min()),
        section=tuple(states.ravel().tolist()),
        lyapunov_error=error,
        **costs,
    )


def members(found):
    """Numbers of the responses on each attractor."""
    return [tuple(np.flatnonzero(found.of_response == k).tolist()) for k in range(len(found.first))]


@pytest.mark.parametrize("seed", range(200))
def test_scenes_together_and_alone_as_one_by_one(seed):
    rng = np.random.default_rng(seed)
    n_scenes = int(rng.integers(1, 8))
    n, families = int(rng.integers(0, 60)), orbits(rng, int(rng.integers(1, 4)))
    rows = [random_response(rng, families) for _ in range(n)]
    responses, scene = Responses.of(rows), rng.integers(n_scenes, size=n)
    counted, symmetric = rng.random(n) < 0.7, rng.random(n_scenes) < 0.7
    omega = OMEGA * (1.0 + 1e-5 * np.arange(n_scenes))
    together = attractors_of_scenes(
        responses, scene, unit=unit_of(omega), symmetric=symmetric, counted=counted
    )
    assert np.all(np.diff(together.scene) >= 0)
    for s in range(n_scenes):
        here = np.flatnonzero(scene == s)
        its = [rows[i] for i in here]
        expected = straightforward(its, omega[s], symmetric[s], counted[here].tolist())
        alone = attractors_of_scenes(
            responses.take(here), np.zeros(len(here), int),
            unit=unit_of(omega[s]), symmetric=symmetric[[s]], counted=counted[here],
        )  # fmt: skip
        columns = (c.tolist() for c in (alone.mirror_of, alone.n_ending, alone.n_starts))
        assert list(zip(members(alone), *columns, strict=True)) == expected
        assert together.numbers[here].tolist() == alone.numbers.tolist()
        of_scene = np.flatnonzero(together.scene == s)
        assert together.number[of_scene].tolist() == alone.number.tolist()
        assert together.first[of_scene].tolist() == here[alone.first].tolist()
        for name in ("n_ending", "n_starts", "mirror_of", "basin_share", "basin_share_error"):
            np.testing.assert_array_equal(getattr(together, name)[of_scene], getattr(alone, name))


@pytest.mark.parametrize("seed", range(60))
def test_responses_in_parts_as_all_at_once(seed):
    rng = np.random.default_rng(seed)
    n_scenes, families = int(rng.integers(1, 4)), orbits(rng, int(rng.integers(1, 4)))
    responses = Responses.of([random_response(rng, families) for _ in range(80)])
    scene, counted = np.sort(rng.integers(n_scenes, size=80)), rng.random(80) < 0.7
    unit = unit_of(OMEGA * (1.0 + 1e-5 * np.arange(n_scenes)))
    at_once = attractors_of_scenes(responses, scene, unit=unit, symmetric=True, counted=counted)
    grouping = Grouping(unit)
    for part in np.split(np.arange(80), np.sort(rng.integers(81, size=4))):
        grouping.add(responses.take(part), scene[part], counted[part])
    found = grouping.attractors(True)
    for name in ("of_response", "scene", "number", "first", "n_ending", "n_starts", "mirror_of"):
        assert getattr(found, name).tolist() == getattr(at_once, name).tolist(), name
    for name, column in responses.take(at_once.first).columns.items():
        np.testing.assert_array_equal(found.leaders.columns[name], column)


def test_the_random_sets_hold_what_matters():
    """Several groups of several members, mirror images, order that rounding decides."""
    rng = np.random.default_rng(0)
    rows = [random_response(rng, orbits(rng, 2)[:8]) for _ in range(10)]
    rows += [random_response(rng, families) for families in [orbits(rng, 2)] for _ in range(300)]
    responses = Responses.of(rows)
    one = np.zeros(len(rows), int)
    found = attractors_of_scenes(responses, one, unit=unit_of(OMEGA), symmetric=True)
    assert sum(len(each) > 3 for each in members(found)) > 5
    images = found.mirror_of.tolist()
    assert any(image not in (NONE, k) for k, image in enumerate(images))
    assert any(image == k for k, image in enumerate(images))
    assert set(responses.columns["response_class"][found.first].tolist()) == {
        ResponseClass.PERIODIC,
        ResponseClass.CHAOTIC,
    }


@pytest.mark.parametrize("n_states", [2, 4, 8])
def test_samples_of_one_distribution_are_one_in_any_number_of_states(n_states):
    """A cloud of 32 points fills a plane, and is sparse in eight dimensions; a torus never is."""
    rng, n = np.random.default_rng(n_states), 400
    solid = rng.normal(size=(2, n_states, n, 32))
    turns = rng.random((2, n, 1)) + 0.381966 * np.arange(32)
    torus = np.stack([np.cos(2 * np.pi * turns + k) for k in range(n_states)], axis=1)
    for p, q in (solid, torus):
        assert np.mean(own_neighbours(p, q) >= 0.75) < 0.01
        beside = q + 2.0 * np.ptp(q, axis=2, keepdims=True)
        assert (own_neighbours(p, beside) == 1.0).all()


def test_a_large_coordinate_hides_no_difference_in_a_small_one():
    """Two wells of one coordinate beside another that swings a thousand times as far."""
    structure = Structure(n=2, m=0, n_cubic=0, loads=((1, False),), contacts=())
    rows = []
    for side in (1.0, -1.0, 1.0 + 1e-7):
        state = [387.0, 0.05 * side, 1.0, 0.01]
        rows.append(
            Response(
                status=Status.OK,
                response_class=ResponseClass.PERIODIC,
                period_multiple=1,
                x_max=[387.0, 0.06 * side],
                x_min=[-387.0, 0.04 * side],
                amplitude=[387.0, 0.01],
                section=tuple(state),
                noise=1e-9,
            )
        )
    found = attractors_of_scenes(
        Responses.of(rows, structure), np.zeros(3, int), unit=np.ones((4, 1)), symmetric=False
    )
    assert found.numbers[0] == found.numbers[2] != found.numbers[1]
