"""Time order: in lockstep an image takes effect exactly 40 ms after its stamp, in real time at its reception."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from synthetic_flight import CAMERA, LATENCY_NS, TRACK, Detector, Drift, odometry, poses_seen, race, settings

from swift_ros import configuration, geometry
from swift_ros.errors import UsageError
from swift_ros.estimation.estimator import StateEstimator
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.types import Odometry


@cache
def raw() -> list[Odometry]:
    """Return the odometry of the first 120 ticks."""
    return odometry(race(), Drift(), 1)[:120]


@cache
def gates_seen() -> dict:
    """Return the gate poses of each image of these ticks, by the index of its tick."""
    return {i: poses for i, poses in poses_seen(Detector(outliers=0.0, found=1.0), 1).items() if i < 120}


def estimator(lockstep: bool = True, **changes) -> StateEstimator:
    return StateEstimator(settings("state_estimator", EstimatorSettings, **changes), TRACK, CAMERA, lockstep)


def fly(core: StateEstimator, answer_after: int):
    """Return states and updates of a flight; the gates of an image come `answer_after` ticks after its stamp."""
    states, updates, waiting = [], [], []

    def collect(output):
        states.extend(output.states)
        updates.extend(output.updates)

    for i, sample in enumerate(raw()):
        if i in gates_seen():
            core.image(sample.stamp_ns)
            waiting.append(i)
        collect(core.odometry(sample))
        while waiting and waiting[0] <= i - answer_after:
            collect(core.gates(raw()[waiting[0]].stamp_ns, gates_seen()[waiting.pop(0)]))
    for i in waiting:
        collect(core.gates(raw()[i].stamp_ns, gates_seen()[i]))
    return states, updates


def test_in_lockstep_the_states_do_not_depend_on_the_delay_of_the_gates():
    quick, _ = fly(estimator(), answer_after=0)
    slow, _ = fly(estimator(), answer_after=9)
    assert [state.stamp_ns for state in slow] == [sample.stamp_ns for sample in raw()]
    for one, other in zip(quick, slow, strict=True):
        assert np.array_equal(one.p_world, other.p_world)
        assert np.array_equal(one.q_world_body, other.q_world_body)
        assert np.array_equal(one.covariance_pose, other.covariance_pose)


def test_an_image_takes_effect_exactly_its_latency_after_its_stamp():
    first = min(i for i, poses in gates_seen().items() if poses)
    with_gates, without = estimator(), estimator()
    differs = []
    for i, sample in enumerate(raw()[: first + 8]):
        states = []
        for core, poses in ((with_gates, gates_seen()[first]), (without, [])):
            if i == first:
                core.image(sample.stamp_ns)
            states += core.odometry(sample).states
            if i == first:
                core.gates(sample.stamp_ns, poses)
        differs.append(not np.array_equal(states[0].p_world, states[1].p_world))
    assert differs.index(True) == first + LATENCY_NS // 10_000_000
    assert not any(differs[: first + 4]) and all(differs[first + 4 :])


def test_a_state_waits_for_the_gates_of_every_image_that_is_due_before_it():
    core = estimator()
    core.image(raw()[0].stamp_ns)
    released = [len(core.odometry(sample).states) for sample in raw()[:8]]
    assert released == [1, 1, 1, 1, 0, 0, 0, 0], "the image of t = 0 is due at 40 ms"
    assert len(core.gates(raw()[0].stamp_ns, []).states) == 4


def test_no_state_waits_for_an_image_whose_gates_have_already_come():
    core = estimator()
    core.gates(raw()[0].stamp_ns, [])
    core.image(raw()[0].stamp_ns)
    assert sum(len(core.odometry(sample).states) for sample in raw()[:8]) == 8


def test_in_real_time_nothing_waits_and_late_gates_are_applied_at_their_stamp():
    core = estimator(lockstep=False)
    states, updates = [], []
    for i, sample in enumerate(raw()):
        core.image(sample.stamp_ns)
        output = core.odometry(sample)
        assert [state.stamp_ns for state in output.states] == [sample.stamp_ns]
        states += output.states
        updates += output.updates
        if i - 6 in gates_seen():
            updates += core.gates(raw()[i - 6].stamp_ns, gates_seen()[i - 6]).updates
    assert [stamp for stamp, _ in updates] == [raw()[i].stamp_ns for i in gates_seen() if i + 6 < len(raw())]
    assert any(update.accepted for _, group in updates for update in group)


def test_gates_older_than_the_odometry_buffer_are_refused_with_a_reason():
    core = estimator(lockstep=False, history_s=0.2)
    for sample in raw()[:60]:
        core.odometry(sample)
    observed = next(poses for poses in gates_seen().values() if poses)
    [(_, updates)] = core.gates(raw()[3].stamp_ns, observed).updates
    assert not updates[0].accepted and "the buffer holds no odometry" in updates[0].reason


INVALID = {
    "a position that is not a number": {"p_world": np.array([np.nan, 0, 0])},
    "a velocity that is not a number": {"v_body": np.array([np.inf, 0, 0])},
    "an absurd position": {"p_world": np.array([0, 4e156, 0])},
    "an absurd rate": {"omega_body": np.array([0, 0, -1e300])},
    "an earlier stamp": {"stamp_ns": raw()[5].stamp_ns},
}


@pytest.mark.parametrize("name", INVALID)
def test_invalid_odometry_is_refused_with_a_sentence(name):
    core = estimator()
    for sample in raw()[:10]:
        core.odometry(sample)
    output = core.odometry(replace(raw()[10], **INVALID[name]))
    assert not output.states and "refused" in output.warnings[0]
    assert len(core.odometry(raw()[11]).states) == 1


@pytest.mark.parametrize(
    "changes", [{"rays_body": np.full((4, 3), np.nan)}, {"rays_body": np.full((4, 3), 1e200)}, {"confidence": np.nan}]
)
def test_gates_that_are_absurd_or_not_numbers_are_refused_with_a_sentence(changes):
    core = estimator()
    core.odometry(raw()[0])
    index = next(i for i, poses in gates_seen().items() if poses)
    invalid = replace(gates_seen()[index][0], **changes)
    output = core.gates(raw()[index].stamp_ns, [invalid])
    assert "not a number" in output.warnings[0]
    assert all(np.isfinite(s.p_world).all() for sample in raw()[1:60] for s in core.odometry(sample).states)


def test_on_the_podium_any_odometry_frame_is_aligned_with_the_map():
    yaw, shift = geometry.quaternion_from_yaw(np.float64(1.3)), np.array([4.0, -2.0, 0.5])
    core = estimator(alignment="podium")
    for i, sample in enumerate(raw()):
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


JUMP = np.array([1.5, -1.0, 0.8])  # m, of the odometry


def errors_after_a_jump(lost: int) -> list[float]:
    """Return the error of each state, m; at tick 300 the odometry has lost a number of samples and jumped."""
    core, truth = estimator(), race()
    observed, errors = poses_seen(Detector(), 2), []
    for i, sample in enumerate(odometry(truth, Drift(), 2)):
        outputs = []
        if not 300 - lost <= i < 300:
            outputs.append(core.odometry(replace(sample, p_world=sample.p_world + (i >= 300) * JUMP)))
        if i in observed:
            outputs.append(core.gates(sample.stamp_ns, observed[i]))
        for state in (state for output in outputs for state in output.states):
            errors.append(np.linalg.norm(state.p_world - truth.p_map[state.stamp_ns // 10_000_000]))
    return errors


def test_the_estimator_recovers_from_odometry_that_is_lost_and_jumps():
    """After a jump of two metres gates are refused, the uncertainty grows, and gates are accepted again."""
    errors = errors_after_a_jump(lost=10)
    assert max(errors[290:310]) > 1.0
    assert max(errors[390:]) < 0.4


def test_a_correction_of_the_odometry_by_its_own_map_does_not_move_the_estimate():
    """The position jumps by two metres, the velocity does not."""
    assert max(errors_after_a_jump(lost=0)) < 0.4


def test_the_error_names_an_unknown_filter():
    path = "config/nodes.yaml, section 'state_estimator'"
    content = dict(vars(settings("state_estimator", EstimatorSettings)))
    with pytest.raises(UsageError, match="'filter' must be one of corners, drift, not 'magic'"):
        configuration.build(EstimatorSettings, content | {"filter": "magic"}, path)
