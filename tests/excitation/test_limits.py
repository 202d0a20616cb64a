"""What a motion may ask of robot, plate and surroundings: random ones keep to it, proofs hold."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given

import testbed as tb
from testbed.bodies.shapes.shapes import Shape, ShapeKind
from testbed.core.base.arrays import Array
from testbed.core.base.errors import NoFeasibleMotion, UnknownName
from testbed.core.base.transform import Transform
from testbed.core.dynamics.newton_euler import poses
from testbed.core.robot.rotations import rotvec_to_matrix
from testbed.motion.clearance import MAX_DISTANCE, ClearanceTerm, DistanceMeter
from testbed.motion.collision_model import (
    FLOOR_BODY,
    OBSTACLE_BODY,
    PLATE_BODY,
    collision_model,
    distance_rate_bounds,
)
from testbed.motion.fourier import Fourier
from testbed.motion.limits import Limits, joint_limits, motor_efforts
from testbed.motion.proof import (
    INTERVALS,
    MotionConstraints,
    derivative_bounds,
    force_sample_count,
    prove,
    respects_limits_at_samples,
)
from testbed.motion.random_motion import (
    USABLE_SHARE,
    best_random_motion,
    random_motion,
    relative_sigma,
)
from testbed.motion.rest_to_rest import RestToRest, Start, shortest_start
from testbed.motion.samples import KernelForces, derivative_stencil
from testbed.motion.surroundings import select_watched_pairs
from testbed.motion.terms import (
    EffortTerm,
    PlateRange,
    PlateTerm,
    SensorTerm,
    force_curvature_bounds,
)
from tests.helpers.chains import Z, chain
from tests.helpers.refusals import refuses
from tests.helpers.robots import random_robot
from tests.helpers.sensors import random_cut
from tests.helpers.strategies import few, rngs, trees

INF = np.inf
GREY = np.array([0.5, 0.5, 0.5, 1.0])
RANGE = np.array([100.0, INF, 300.0, 40.0, 50.0, INF])
HALF = np.array([0.3, 0.5])
PLATE = np.repeat([0.5, 0.1], 3)


def ball(body: int, radius: float, place: Array) -> Shape:
    """A ball on a body, -1 for the pedestal, about a place in its frame."""
    return Shape(body, "ellipsoid", np.full(3, radius), place, np.eye(3), GREY)


def each(tree: tb.Tree, **changes: object) -> tb.Tree:
    """The tree with every joint changed alike."""
    return replace(tree, joints=tuple(replace(j, **changes) for j in tree.joints))  # type: ignore[arg-type]


def dry(tree: tb.Tree) -> Array:
    return np.array([joint.coulomb for joint in tree.joints])


def random_series(rng: np.random.Generator, n: int, harmonics: int, size: float = 0.5) -> Fourier:
    parts = size * rng.normal(size=(2, n, harmonics)) / np.arange(1, harmonics + 1)
    return Fourier(rng.uniform(0.05, 0.5), rng.normal(size=n), *parts)


def wide(n: int) -> Limits:
    far = np.full(n, 1e9)
    return Limits(-far, far, far, far, np.full(n, INF))


def rules(tree: tb.Tree, limits: Limits, margin: float = 1.0, **more: object) -> MotionConstraints:
    plain = MotionConstraints(tree, limits, margin, (), None, np.zeros(0))
    return replace(plain, **more)  # type: ignore[arg-type]


@given(trees((2, 6)), rngs)
def test_a_file_without_limits_gets_calm_ones_and_one_end_a_range_as_wide(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    turns = np.array([joint.revolute for joint in tree.joints])
    half, bound = np.where(turns, np.pi, 0.5), float(rng.choice([-7.0, -0.3, 0.0, 0.2, 7.0]))
    high = np.minimum(bound, half)
    for ends, low, top in (
        ((-INF, INF), -half, half),
        ((bound, INF), 0 * half + bound, bound + 2 * half),
        ((-INF, bound), high - 2 * half, high),
        ((-50.0, 40.0), 0 * half - 50.0, 0 * half + 40.0),
    ):
        found = joint_limits(each(tree, position_range=np.array(ends)))
        np.testing.assert_allclose([found.low, found.high], [low, top])
    np.testing.assert_array_equal(found.velocity, np.where(turns, 2.0, 0.5))
    np.testing.assert_array_equal(found.acceleration, np.where(turns, 6.0, 2.0))
    first, second, *_ = tree.names
    own = joint_limits(each(tree, max_velocity=1.5), {first: 0.2, second: 9.0}, {second: 0.7})
    assert own.velocity.tolist() == [0.2, *[1.5] * (tree.n - 1)]  # the lower of two counts
    assert own.acceleration[1] == 0.7


@pytest.mark.slow
def test_limits_that_mean_nothing_name_their_joint(puma: tb.Tree) -> None:
    weak, stuck = each(puma, max_effort=0.1), each(puma, position_range=np.array([0.3, 0.3]))
    motion, effort = random_motion(puma, None, 0.2, 4, 3), 0.01 * joint_limits(puma).effort
    held = replace(joint_limits(puma), effort=effort)  # less than the weight needs
    smooth = each(puma, coulomb=0.0)
    lying = rules(smooth, held, force_limits=(EffortTerm(smooth, held, 1.0),))
    dragging = each(puma, coulomb=0.9 * joint_limits(puma).effort.min())
    for kind, culprit, asked in (
        (UnknownName, "wrist", lambda: joint_limits(puma, {"wrist": 1.0})),
        (UnknownName, "wrist", lambda: joint_limits(puma, None, {"wrist": 1.0})),
        (NoFeasibleMotion, "'waist'", lambda: joint_limits(stuck)),
        (NoFeasibleMotion, "shoulder", lambda: random_motion(weak)),
        (NoFeasibleMotion, "elbow", lambda: EffortTerm(dragging, joint_limits(puma), 0.9)),
        (NoFeasibleMotion, "", lambda: PlateRange(RANGE * [1, 1, 0, 1, 1, 1], HALF)),
        (NoFeasibleMotion, "", lambda: PlateRange(RANGE, -HALF)),
        (NoFeasibleMotion, "effort", lambda: shortest_start(motion, lying)),
    ):
        with refuses(kind, culprit):
            asked()


# random motions


def test_weak_motors_slow_a_motion_no_more_than_they_must(puma: tb.Tree) -> None:
    """What is as fast as the efforts allow exceeds them a step of a ninth faster."""
    puma = replace(puma, gravity=np.zeros(3))  # efforts then fall with the speed
    weak, slowed = each(puma, max_effort=12.0), 0
    for seed in range(5):
        free, slow = (random_motion(tree, None, 0.1, 5, seed) for tree in (puma, weak))
        steps = np.log(slow.sine / free.sine) / np.log(0.9)
        np.testing.assert_allclose(steps, round(steps[0, 0]), atol=1e-9)
        times = np.linspace(0, slow.period, 500, endpoint=False)
        assert np.abs(motor_efforts(weak, slow.at(times))).max() <= USABLE_SHARE * 12.0
        if steps[0, 0] > 0.5:
            slowed += 1
            faster = replace(slow, sine=slow.sine / 0.9, cosine=slow.cosine / 0.9)
            assert np.abs(motor_efforts(weak, faster.at(times))).max() > USABLE_SHARE * 12.0
    assert slowed > 1


def test_the_best_of_a_few_is_the_best_of_them_by_the_sigma_of_least_squares() -> None:
    """Rms of sigma over value; small values count as a twentieth of the largest of their unit."""
    tree = random_robot(np.random.default_rng(0), 3).tree()
    minimal, limits, rng = tb.minimal_set(tree, "wrench"), joint_limits(tree), np.random.default_rng
    motion, score = best_random_motion(rules(tree, limits), minimal, PLATE, 0.1, 5, 8, rng(7))
    same = rng(7)
    again = [random_motion(tree, limits, 0.1, 5, same) for _ in range(8)]
    scores = [relative_sigma(tree, m, minimal, PLATE) for m in again]
    assert score == min(scores)
    np.testing.assert_array_equal(motion.sine, again[int(np.argmin(scores))].sine)
    phi = tb.regressor(tree, motion.at(np.arange(100) / 100 * motion.period), minimal)
    rows = (phi / PLATE[:, None]).reshape(-1, minimal.count)
    values, units = np.abs(minimal.values(tb.barycentric(tree))), np.array(minimal.units)
    largest = np.array([values[units == unit].max() for unit in units])
    sigma = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows))) / np.maximum(values, largest / 20)
    assert (values < largest / 20).any()
    assert score == pytest.approx(np.sqrt(np.mean(sigma**2)), rel=1e-6)
    lame = Fourier(0.1, np.zeros(3), *np.zeros((2, 3, 2)))
    assert relative_sigma(tree, lame, minimal, PLATE) == INF


# proofs: what is proven holds at every moment


@few(6)
@given(trees((5, 5)), rngs)
def test_bounds_between_samples_are_those_of_motions_and_forces(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    """Largest positions, velocities, accelerations; second differences of forces in every span."""
    motion, ones = random_series(rng, 5, 4), np.ones(5)
    limits = replace(wide(5), velocity=ones, acceleration=ones, low=-ones, high=ones)
    left = {m.label: m.left for m in prove(motion, rules(tree, limits)).margins}
    fine = motion.at(np.linspace(0, motion.period, 50_001))
    shares = {"position": fine.q, "velocity": fine.qd, "acceleration": fine.qdd}
    for kind, values in shares.items():
        most = np.abs(values).max(axis=0)
        told = np.array([1.0 - left[f"{kind} of '{name}'"] for name in tree.names])
        assert ((most * (1 - 1e-12) <= told) & (told <= most * 1.001)).all()
    count = force_sample_count(motion.period)
    bounds, step = (
        force_curvature_bounds(tree, derivative_bounds(motion, count)),
        motion.period / count,
    )
    at = motion.at(step * np.arange(-1.0, count + 1))

    def curved(values: Array) -> Array:
        """Largest second derivative in every span, (k, SPANS)."""
        second = np.abs(np.diff(values, 2, axis=0)) / step**2
        return np.asarray(second[:count].reshape(INTERVALS, -1, values.shape[1]).max(axis=1).T)

    wrench = curved(tb.base_wrench(tree, at))
    slack = 1 + 1e-3  # differences look a sample beyond a span
    assert (slack * bounds.joints >= curved(tb.joint_forces(tree, at))).all()
    assert (slack * bounds.force >= wrench[:3]).all()
    assert (slack * bounds.moment >= wrench[3:]).all()


@few(8)
@given(trees((2, 6)), rngs)
def test_a_force_sensor_is_a_plate_that_moves(tree: tb.Tree, rng: np.random.Generator) -> None:
    """Shares of its ranges, derivatives by the whole robot's motion, bounds in every span."""
    cut = random_cut(tree, rng)
    own = [tree.index(name) for name in cut.names]
    term, motion = SensorTerm(tree, cut, PlateRange(RANGE), 0.9), random_series(rng, tree.n, 3)

    def shares(at: tb.Motion) -> Array:
        wrench = tb.base_wrench(cut, tb.Motion(at.t, at.q[:, own], at.qd[:, own], at.qdd[:, own]))
        return np.array([s * wrench[:, k] / RANGE[k] for k in (0, 2, 3, 4) for s in (1, -1)]) - 0.9

    at = motion.at(np.linspace(0, motion.period, 40))
    samples = KernelForces(at, {}, derivative_stencil(tree))
    np.testing.assert_allclose(term.values(samples), shares(at), atol=1e-12)
    away, slopes = rng.normal(size=(3, tree.n)), term.slopes(samples)
    here = np.stack([at.q, at.qd, at.qdd])
    there = [tb.Motion(at.t, *(here + h * away[:, None])) for h in (1e-5, -1e-5)]
    along = np.einsum("ksg,s->kg", slopes, away.ravel())
    size = np.abs(along).max(initial=1.0)
    near = (shares(there[0]) - shares(there[1])) / 2e-5
    np.testing.assert_allclose(along, near, atol=1e-7 * size)
    count = force_sample_count(motion.period)
    step = motion.period / count
    bounds = term.curvatures(force_curvature_bounds(tree, derivative_bounds(motion, count)))
    second = np.abs(np.diff(shares(motion.at(step * np.arange(-1.0, count + 1))), 2)) / step**2
    most = second[:, :count].reshape(len(second), INTERVALS, -1).max(axis=2)
    assert ((1 + 1e-3) * bounds >= most - 1e-6).all()


@pytest.mark.slow
@pytest.mark.parametrize("haste", [1.0, 10.0])
def test_efforts_and_plate_are_proven_as_tightly_as_they_are(haste: float, puma: tb.Tree) -> None:
    """With friction of either sign, the most of a fine grid, and hardly more.

    In haste it takes more samples than a proof begins with.
    """
    limits, pedestal = joint_limits(puma), tb.pedestal_wrench(puma)
    motion = random_motion(puma, limits, 0.1, 5, int(haste))
    motion = replace(motion, fundamental=haste * motion.fundamental)
    held = rules(puma, limits, force_limits=(EffortTerm(puma, limits, 1.0),))
    left = [m.left for m in prove(motion, held).margins if "effort" in m.label]
    fine = motion.at(np.linspace(0, motion.period, 30_001))
    smooth = motor_efforts(each(puma, coulomb=0.0), fine)
    used = (np.abs(smooth).max(axis=0) + dry(puma)) / limits.effort
    found = 1 - np.array(left).reshape(-1, 2).min(axis=1)
    assert ((used - 1e-12 <= found) & (found <= used + 0.003)).all()
    wrench = tb.base_wrench(puma, fine) + pedestal
    most, place = np.abs(wrench).max(axis=0), np.abs(wrench[:, [4, 3]] / wrench[:, [2]])
    for factor, holds in ((1.01, True), (0.99, False)) if haste == 1 else ():
        pressed = PlateRange(np.full(6, INF), factor * place.max(axis=0))
        for range_ in (PlateRange(factor * most), pressed):
            held = rules(puma, limits, force_limits=(PlateTerm(range_, pedestal, 1.0),))
            assert prove(motion, held).is_valid is holds
            assert respects_limits_at_samples(motion, held) is holds


def test_bodies_that_meet_between_samples_are_found() -> None:
    """A ball on an arm grazes a ball on the floor twice a period, for a moment."""
    two = chain(("revolute", Z), ("revolute", Z))
    hand = replace(two.joints[1], offset=np.array([1.0, 0, 0]))
    two = replace(two, joints=(two.joints[0], hand))
    motion = Fourier(1.0, np.zeros(2), np.array([[2.0], [0.0]]), np.zeros((2, 1)))
    angle = 2.0 * np.sin(0.77)  # passed at no sample of a millisecond
    for gap, holds in ((0.0099, True), (-0.0001, False)):
        away = 1.0 + 0.1 + 0.01 + gap
        post = ball(-1, 0.05, away * np.array([np.cos(angle), np.sin(angle), 0]))
        collision = collision_model(two, [post, ball(1, 0.05, np.zeros(3))])
        found = prove(motion, rules(two, wide(2), collision=collision, clearance=np.full(1, 0.01)))
        assert [m.is_respected for m in found.margins if m.unit == "m"] == [holds]
        assert found.postures < 5000


@pytest.mark.slow
@few(5)
@given(trees((3, 3)), rngs)
def test_a_motion_goes_from_rest_to_rest_along_its_path(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    """All derivatives against differences; the largest acceleration of a start is told."""
    motion = random_series(rng, 3, 4)
    start, times, h = Start(motion, 2.0), np.linspace(0.01, 1.99, 400), 1e-4
    for order in range(4):
        near = start.derivative(times + h, order) - start.derivative(times - h, order)
        wanted = start.derivative(times, order + 1)
        np.testing.assert_allclose(near / (2 * h), wanted, atol=1e-5 * np.abs(wanted).max())
    fifth = np.diff(start.derivative(times, 4), axis=0) / np.diff(times)[:, None]
    assert (np.abs(fifth) <= start.fifth_derivative).all()
    whole = RestToRest(start, 3)
    times, h = np.linspace(-3.0, whole.end + 3.0, 2001), 1e-5
    samples = whole.at(times)
    np.testing.assert_allclose(samples.q, motion.at(whole.path_time(times)).q, atol=1e-12)
    inside = (times >= 0) & (times <= whole.end)
    np.testing.assert_array_equal(samples.q[inside], motion.at(times[inside]).q)
    for left, right in (("q", "qd"), ("qd", "qdd")):
        after, before = (getattr(whole.at(times + s * h), left) for s in (1, -1))
        wanted = getattr(samples, right)
        np.testing.assert_allclose((after - before) / (2 * h), wanted, atol=1e-3)
    still = (times < -2.0) | (times > whole.end + 2.0)
    assert max(np.abs(samples.qd[still]).max(), np.abs(samples.qdd[still]).max()) < 1e-9
    start, margins = shortest_start(random_series(rng, 3, 3, 0.05), rules(tree, wide(3)))
    told = {m.label: m for m in margins[:3]}  # of the start; the others are of its mirror image
    size = np.abs(start.derivative(np.linspace(0, start.duration, 4001), 2))
    for j, name in enumerate(tree.names):
        instant = np.array([told[f"acceleration of '{name}'"].instant])
        assert np.abs(start.derivative(instant, 2))[0, j] > 0.99 * size[:, j].max()


SIZES: dict[ShapeKind, int] = {"box": 3, "ellipsoid": 3, "cylinder": 2, "capsule": 2, "mesh": 0}


def distances(tree: tb.Tree, *shapes: Shape, **around: object) -> dict[tuple[int, int], float]:
    """In the posture of zeros, by pair."""
    collision = collision_model(tree, shapes, **around)  # type: ignore[arg-type]
    found = DistanceMeter(collision, max_distance=9.0).measure(np.zeros(tree.n)).values
    return dict(zip(collision.pairs, found.tolist(), strict=True))


@few(8)
@given(trees((2, 6)), rngs)
def test_distances_of_balls_are_those_of_their_centres_and_change_as_differences_do(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    """No faster than levers; a limit is what a distance lacks."""
    shapes = [ball(j, rng.uniform(0.02, 0.05), 0.1 * rng.normal(size=3)) for j in range(-1, tree.n)]
    collision, limits = collision_model(tree, shapes), joint_limits(tree)
    joined = {(joint.parent, j) for j, joint in enumerate(tree.joints)}
    assert set(collision.pairs) == {(a, b) for b in range(tree.n) for a in range(-1, b)} - joined
    meter, bound = (
        DistanceMeter(collision, max_distance=50.0),
        distance_rate_bounds(collision, limits),
    )
    for q in rng.uniform(limits.low, limits.high, (4, tree.n)):
        at = [Transform(), *poses(tree, q[None])]
        centre = [np.ravel(X.point(s.position)) for s, X in zip(shapes, at, strict=True)]
        here = meter.measure(q, slopes=True)
        for (a, b), found in zip(collision.pairs, here.values, strict=True):
            apart = np.linalg.norm(centre[a + 1] - centre[b + 1])
            assert found == pytest.approx(apart - shapes[a + 1].size[0] - shapes[b + 1].size[0])
        for j, step in enumerate(1e-6 * np.eye(tree.n)):
            near = meter.measure(q + step).values - meter.measure(q - step).values
            np.testing.assert_allclose(here.slopes[:, j], near / 2e-6, atol=1e-6)
        assert (np.abs(here.slopes) <= bound + 1e-9).all()
    for (a, b), row in zip(collision.pairs, bound, strict=True):
        between = set(tree.chain(a)) ^ set(tree.chain(b))
        assert {j for j in range(tree.n) if row[j] > 0} == between  # others move neither or both
    term = ClearanceTerm(collision, np.full(len(collision.pairs), 0.05))
    for q in rng.uniform(limits.low, limits.high, (2, 6, tree.n)):
        samples = KernelForces(tb.Motion(np.arange(6.0), q, q, q), {}, None)
        found = DistanceMeter(collision, 0.15).measure(q)
        np.testing.assert_allclose(term.values(samples), (0.05 - found.values.T) / 0.1)


@few(5)
@given(trees((2, 4)), rngs)
def test_shapes_that_are_passed_over_are_not_the_nearest(
    tree: tb.Tree, rng: np.random.Generator
) -> None:
    """Several shapes a body, of every kind: the least distance of all pairs, each measured."""

    def some(body: int, kind: ShapeKind, count: int) -> Shape:
        size, turn = (
            rng.uniform(0.01, 0.1, count),
            rotvec_to_matrix(rng.normal() * np.array([0.6, 0.0, 0.8])),
        )
        corners = rng.normal(size=(0 if count else 20, 3)) * rng.uniform(0.02, 0.1, 3)
        return Shape(body, kind, size, 0.2 * rng.normal(size=3), turn, GREY, vertices=corners)

    shapes = [some(body, *each) for body in range(-1, tree.n) for each in SIZES.items()]
    collision = collision_model(tree, shapes, floor=-0.3)
    model, data = collision.model, mujoco.MjData(collision.model)
    for q in rng.normal(size=(5, tree.n)):
        data.qpos[collision.order] = q
        mujoco.mj_kinematics(model, data)
        wanted = [
            min(
                mujoco.mj_geomDistance(model, data, a, b, MAX_DISTANCE, None)
                for a, b in geoms.T.tolist()
            )
            for geoms in collision.geoms
        ]
        np.testing.assert_allclose(DistanceMeter(collision).measure(q).values, wanted, atol=1e-6)


def test_what_stands_around_the_robot_is_watched_from_the_first_link_on(puma: tb.Tree) -> None:
    """The first link touches the pedestal, stands on the floor, and has to keep clear of a box."""
    shapes = [ball(j, 0.05, np.zeros(3)) for j in range(-1, 3)]
    box = Shape(-1, "box", np.array([0.1, 0.2, 0.3]), np.array([1.0, 0, 0]), np.eye(3), GREY)
    found = distances(puma, *shapes, obstacles=[box], floor=-2.0)
    around = {
        (OBSTACLE_BODY, 0),
        (OBSTACLE_BODY, 1),
        (OBSTACLE_BODY, 2),
        (FLOOR_BODY, 1),
        (FLOOR_BODY, 2),
    }
    assert {(PLATE_BODY, 1), (PLATE_BODY, 2), (0, 2), *around} == set(found)
    height = puma.joints[0].offset[2]
    beside = np.array([0.9, 0.0, max(height - 0.3, 0.0)])
    assert found[OBSTACLE_BODY, 0] == pytest.approx(np.linalg.norm(beside) - 0.05)
    lowest = height + (puma.joints[0].rotation @ puma.joints[1].offset)[2]
    assert found[FLOOR_BODY, 1] == pytest.approx(lowest + 2 - 0.05)


def test_pairs_that_always_touch_are_left_out_and_near_ones_keep_half(puma: tb.Tree) -> None:
    second = puma.joints[1]  # on the axes of two parallel joints: as near in every posture
    near = ball(2, 0.1, np.zeros(3)), ball(0, 0.05, second.rotation.T @ second.offset)
    far = distances(puma, *near)[0, 2]
    touching = ball(0, 0.6, np.zeros(3)), ball(2, 0.9, np.zeros(3))
    for shapes, clearance, kept in ((near, 1.01 * far, [far / 2]), (touching, 0.02, [])):
        collision = collision_model(puma, list(shapes))
        found = select_watched_pairs(collision, joint_limits(puma), clearance)
        np.testing.assert_allclose(found.clearance, kept, rtol=0.2)
        (note,) = tb.sentences(found.diagnostics)
        assert [link for link in ("'link1'", "'link3'") if link not in note] == []
