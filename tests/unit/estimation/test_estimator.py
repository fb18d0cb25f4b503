"""When what takes effect: in lockstep an image counts exactly 40 ms after its stamp, in real time once it is there."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_flight import CAMERA, LATENCY_NS, TRACK, Detector, Drift, odometry, poses_seen, race, settings

from swift_ros import configuration, geometry
from swift_ros.errors import UsageError
from swift_ros.estimation.estimator import StateEstimator
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.types import Odometry

RAW = odometry(race(), Drift(), 1)[:120]
SEEN = {i: poses for i, poses in poses_seen(Detector(outliers=0.0, found=1.0), 1).items() if i < 120}


def estimator(lockstep: bool = True, **changes) -> StateEstimator:
    return StateEstimator(settings("state_estimator", EstimatorSettings, **changes), TRACK, CAMERA, lockstep)


def in_order(core: StateEstimator, answer_after: int):
    """Fly with each image's answer arriving `answer_after` ticks after it was taken; return states and updates."""
    states, updates, waiting = [], [], []

    def note(output):
        states.extend(output.states)
        updates.extend(output.updates)

    for i, sample in enumerate(RAW):
        if i in SEEN:
            core.image(sample.stamp_ns)
            waiting.append(i)
        note(core.odometry(sample))
        while waiting and waiting[0] <= i - answer_after:
            note(core.gates(RAW[waiting[0]].stamp_ns, SEEN[waiting.pop(0)]))
    for i in waiting:
        note(core.gates(RAW[i].stamp_ns, SEEN[i]))
    return states, updates


def test_in_lockstep_the_states_are_the_same_however_late_the_answers_come():
    quick, _ = in_order(estimator(), answer_after=0)
    slow, _ = in_order(estimator(), answer_after=9)
    assert [state.stamp_ns for state in slow] == [sample.stamp_ns for sample in RAW]
    for one, other in zip(quick, slow, strict=True):
        assert np.array_equal(one.p_world, other.p_world)
        assert np.array_equal(one.q_world_body, other.q_world_body)
        assert np.array_equal(one.covariance_pose, other.covariance_pose)


def test_an_image_takes_effect_exactly_its_latency_after_its_stamp():
    first = min(i for i, poses in SEEN.items() if poses)
    with_it, without = estimator(), estimator()
    moved = []
    for i, sample in enumerate(RAW[: first + 8]):
        states = []
        for core, poses in ((with_it, SEEN[first]), (without, [])):
            if i == first:
                core.image(sample.stamp_ns)
            states += core.odometry(sample).states
            if i == first:
                core.gates(sample.stamp_ns, poses)
        moved.append(not np.array_equal(states[0].p_world, states[1].p_world))
    assert moved.index(True) == first + LATENCY_NS // 10_000_000
    assert not any(moved[: first + 4]) and all(moved[first + 4 :])


def test_a_state_waits_for_the_answer_to_every_image_that_is_due_before_it():
    core = estimator()
    core.image(RAW[0].stamp_ns)
    released = [len(core.odometry(sample).states) for sample in RAW[:8]]
    assert released == [1, 1, 1, 1, 0, 0, 0, 0], "the image of t = 0 is due at 40 ms"
    assert len(core.gates(RAW[0].stamp_ns, []).states) == 4


def test_an_answer_that_overtakes_its_announcement_is_not_waited_for():
    core = estimator()
    core.gates(RAW[0].stamp_ns, [])
    core.image(RAW[0].stamp_ns)
    assert sum(len(core.odometry(sample).states) for sample in RAW[:8]) == 8


def test_in_real_time_nothing_waits_and_late_gates_count_where_they_were_seen():
    core = estimator(lockstep=False)
    states, updates = [], []
    for i, sample in enumerate(RAW):
        core.image(sample.stamp_ns)
        output = core.odometry(sample)
        assert [state.stamp_ns for state in output.states] == [sample.stamp_ns]
        states += output.states
        updates += output.updates
        if i - 6 in SEEN:
            updates += core.gates(RAW[i - 6].stamp_ns, SEEN[i - 6]).updates
    assert [stamp for stamp, _ in updates] == [RAW[i].stamp_ns for i in SEEN if i + 6 < len(RAW)]
    assert any(update.accepted for _, group in updates for update in group)


def test_gates_from_before_all_odometry_are_refused_with_a_reason():
    core = estimator(lockstep=False, history_s=0.2)
    for sample in RAW[:60]:
        core.odometry(sample)
    seen = next(poses for poses in SEEN.values() if poses)
    [(_, updates)] = core.gates(RAW[3].stamp_ns, seen).updates
    assert not updates[0].accepted and "no odometry is kept" in updates[0].reason


BROKEN = {
    "a position that is not a number": {"p_world": np.array([np.nan, 0, 0])},
    "a velocity that is not a number": {"v_body": np.array([np.inf, 0, 0])},
    "a stamp from before": {"stamp_ns": RAW[5].stamp_ns},
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_odometry_is_left_out_with_a_sentence(name):
    core = estimator()
    for sample in RAW[:10]:
        core.odometry(sample)
    output = core.odometry(replace(RAW[10], **BROKEN[name]))
    assert not output.states and "left out" in output.complaints[0]
    assert len(core.odometry(RAW[11]).states) == 1


def test_gates_that_are_not_numbers_are_left_out_with_a_sentence():
    core = estimator()
    core.odometry(RAW[0])
    index = next(i for i, poses in SEEN.items() if poses)
    broken = replace(SEEN[index][0], rays_body=np.full((4, 3), np.nan))
    output = core.gates(RAW[index].stamp_ns, [broken])
    assert "not a number" in output.complaints[0]
    assert all(np.isfinite(s.p_world).all() for sample in RAW[1:60] for s in core.odometry(sample).states)


def test_on_the_podium_any_frame_of_the_odometry_becomes_the_map():
    yaw, shift = geometry.quaternion_from_yaw(np.float64(1.3)), np.array([4.0, -2.0, 0.5])
    core = estimator(alignment="podium")
    for i, sample in enumerate(RAW):
        turned = Odometry(
            sample.stamp_ns,
            geometry.rotate(yaw, sample.p_world) + shift,
            geometry.quaternion_multiply(yaw, sample.q_world_body),
            sample.v_body,
            sample.omega_body,
        )
        [state] = core.odometry(turned).states
        if i == 0:
            assert np.allclose(state.p_world, TRACK.start)
            assert np.degrees(geometry.yaw_of(state.q_world_body)) == pytest.approx(TRACK.start_yaw_deg)
    assert np.linalg.norm(state.p_world - sample.p_world) < 0.1


def test_a_jump_of_the_odometry_is_recovered_from():
    """Two metres aside, all at once: gates are refused, doubt grows, and the map is found again."""
    core, truth = estimator(), race()
    raw, seen = odometry(truth, Drift(), 2), poses_seen(Detector(), 2)
    errors = []
    for i, sample in enumerate(raw):
        if i >= 300:
            sample = replace(sample, p_world=sample.p_world + [1.5, -1.0, 0.8])
        for state in core.odometry(sample).states:
            errors.append(np.linalg.norm(state.p_world - truth.p_map[len(errors)]))
        if i in seen:
            for state in core.gates(sample.stamp_ns, seen[i]).states:
                errors.append(np.linalg.norm(state.p_world - truth.p_map[len(errors)]))
    assert max(errors[300:320]) > 1.0
    assert max(errors[400:]) < 0.4


def test_an_unknown_filter_is_named_with_its_file():
    path = "config/nodes.yaml, section 'state_estimator'"
    content = dict(vars(settings("state_estimator", EstimatorSettings)))
    with pytest.raises(UsageError, match="'filter' must be one of corners, drift, not 'magic'"):
        configuration.build(EstimatorSettings, content | {"filter": "magic"}, path)
