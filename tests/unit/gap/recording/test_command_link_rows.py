"""The command link of recordings whose rows are slower than the flight controller's loop."""

import numpy as np
import pytest
from rate_loop_flight import GAINS, RATE_HZ, flight, rms, vehicle

from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.gap.discovery.equation_search import EquationTerm, is_of_rows
from swift_sim_bridge.gap.discovery.features import build_features
from swift_sim_bridge.gap.inference.row_sampling import row_bounds
from swift_sim_bridge.gap.inference.sensitivity import perturbed_variants
from swift_sim_bridge.gap.pipeline import hypotheses
from swift_sim_bridge.gap.recording import command_link, rate_pid
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel


def logged(table, divisor: int, kind: str = "held", lost: float = 0.0, jitter: float = 0.0) -> FlightTable:
    """Return a flight as a logger with slower rows writes it: the command in force at each row, or the row's mean.

    Its stamps scatter by `jitter`, a share of the row.
    """
    t, rng = table["gyro_body"].t, np.random.default_rng(1)
    passes = np.arange(divisor, len(t), divisor)
    passes = passes[rng.random(len(passes)) >= lost]
    stamps = t[passes] + divisor / RATE_HZ * np.clip(jitter * rng.standard_normal(len(passes)), -0.4, 0.4)

    def rows(values):
        back = range(divisor) if kind == "mean" else [divisor // 2 if kind == "late" else 0]
        return Samples(stamps, np.mean([values[passes - one] for one in back], axis=0))

    channels = {"gyro_body": Samples(stamps, table["gyro_body"].values[passes])}
    for name in ("motor_command", "omega_command_body", "thrust_command"):
        samples = table[name]
        channels[name] = rows(samples.values[np.searchsorted(samples.t, t + 1e-9, "right") - 1])
    return FlightTable(table.name, channels)


def link(divisor, kind="held", lost_rows=0.0, jitter=0.0, shift_error_s=0.0, **errors):
    table = logged(flight(**errors), divisor, kind, lost_rows, jitter)
    loop = rate_pid.rate_pid_from_vehicle(vehicle())
    rows = command_link.command_rows_of(table["motor_command"], None, loop.step_s)
    shift_s = {"held": 0.5, "mean": 1.0 - 0.5 * divisor, "late": 0.5 - divisor // 2}[kind] / RATE_HZ
    return command_link.read_command_link(table, loop, rows.moved(shift_s + shift_error_s - rows.shift_s, 0.0))


@pytest.mark.parametrize("divisor", [2, 3, 4])
@pytest.mark.parametrize("kind", ["held", "mean", "late"])
def test_the_received_commands_are_found_in_slower_rows(divisor, kind):
    assert GAINS["rate_hz"] == RATE_HZ
    found = link(divisor, kind, lost_rows=0.02)
    sent, left = found.passes.sent, found.residuals([{}])[0]
    assert found.passes.observable.mean() > 0.7
    assert np.all(rms(left) < 0.25 * sent.std(axis=0)), rms(left) / sent.std(axis=0)
    seen = found.passes.observable
    sizes = [np.polyfit(found.passes.in_force(found.passes.first)[seen, i], left[seen, i], 1)[0] for i in range(4)]
    assert np.all(np.abs(sizes) < 0.015), sizes  # no scale of rates or throttle


@pytest.mark.parametrize("divisor", [2, 3, 4])
def test_a_third_of_the_commands_lost_is_found_in_slower_rows(divisor):
    found = link(divisor, lost=0.3)
    assert found.timing.lost.sum() / found.timing.distinct.sum() == pytest.approx(0.3, abs=0.08)
    assert not link(divisor).timing.lost.sum() > 0.01 * len(link(divisor).timing.lost)


@pytest.mark.parametrize(("divisor", "has_all"), [(2, True), (10, False)])
def test_rows_that_miss_commands_cannot_show_which_were_lost(divisor, has_all):
    recording = read_recording(logged(flight(), divisor), vehicle())
    _, untestable = hypotheses.testable(vehicle(), [recording])
    assert ("dropped_commands" in untestable) != has_all
    assert has_all or "record rows more often" in untestable["dropped_commands"]


@pytest.mark.parametrize("divisor", [2, 3, 4])
def test_stamps_that_scatter_lose_no_command(divisor):
    """On a grid of the mean interval, rows and passes drift apart, and 5 % of the commands seem to be lost."""
    found = link(divisor, lost_rows=0.02, jitter=0.06)
    assert found.timing.distinct.sum() > 200
    assert found.timing.lost.sum() <= 0.002 * found.timing.distinct.sum()
    found = link(divisor, jitter=0.06, lost=0.1)
    assert found.timing.lost.sum() / found.timing.distinct.sum() == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize("rows_late", [0.5, 1.5])
@pytest.mark.parametrize("divisor", [2, 4])
def test_a_delay_that_is_no_whole_number_of_rows_is_no_jitter(divisor, rows_late):
    """Of commands with a common delay, some act a row later than others."""
    recording = read_recording(logged(flight(delay_s=rows_late * divisor / RATE_HZ), divisor), vehicle())
    (bound_s,) = row_bounds(recording)["command_jitter"]
    assert recording.command_link.timing.jitter_s < bound_s


@pytest.mark.parametrize("divisor", [2, 4])
def test_a_jitter_of_more_than_half_a_row_shows_in_slower_rows(divisor):
    recording = read_recording(logged(flight(delay_s=0.012, jitter_s=0.006), divisor), vehicle())
    assert recording.command_link.timing.jitter_s == pytest.approx(0.006, abs=0.0015)
    assert row_bounds(recording)["command_jitter"] < 0.005


@pytest.mark.parametrize("divisor", [2, 4])
def test_a_scale_of_the_rates_and_a_bent_throttle_show_in_slower_rows(divisor):
    found = link(divisor, scale=(1.0, 1.06, 1.0), gain=-0.05)
    terms = {"rate_scale": {"scale": [1.0, 1.06, 1.0], "offset": [0.0] * 3}, "throttle_curve": {"gain": -0.05}}
    before, after = (rms(found.residuals([one])[0]) for one in ({}, terms))
    assert after[1] < 0.8 * before[1] and after[3] < 0.5 * before[3]


def test_a_scale_that_a_shift_within_a_row_would_give_is_the_rows(divisor=10):
    """With rows twice as long as the time between two commands, rates may seem 1 % too small on all axes."""
    found = link(divisor)
    seen, left = found.passes.observable, found.residuals([{}])[0]
    sent = found.passes.in_force(found.passes.first)
    sizes = np.array([np.polyfit(sent[seen, i], left[seen, i], 1)[0] for i in range(3)])
    assert np.all(np.abs(sizes) < found.scale_error() + 0.002), (sizes, found.scale_error())
    assert np.all(found.scale_error() > 5.0 * link(2).scale_error())


def test_a_shift_of_the_gyro_against_the_motors_scales_the_rates_and_belongs_to_the_rows():
    """The gyro lags behind the commands: 2 ms between gyro and motor commands are 1 % of the rates on all axes."""
    plain = link(3)
    rows = slice(100, -100)
    moved = {shift_s: link(3, shift_error_s=shift_s).passes for shift_s in (-1e-3, 1e-3)}
    at = {shift_s: np.searchsorted(one.t, plain.passes.t[rows] + shift_s - 1e-6) for shift_s, one in moved.items()}
    seen = np.all([one.observable[at[shift_s]] for shift_s, one in moved.items()], axis=0)
    earlier, later = (one.received[at[shift_s]][seen] for shift_s, one in moved.items())
    sent = plain.passes.in_force(plain.passes.first)[rows][seen]
    sizes = np.array([np.polyfit(sent[:, i], (later - earlier)[:, i], 1)[0] for i in range(3)])
    assert np.all(np.abs(sizes) > 0.01), sizes
    of_gyro = plain.timing_change()[-1, rows][seen]  # where it is half a row later against the motors
    left = later - earlier + 2e-3 / (0.5 * plain.row_s) * of_gyro
    assert np.all(rms(left)[:3] < 0.2 * rms(later - earlier)[:3]), rms(left) / rms(later - earlier)


def test_a_delay_within_a_row_is_the_recordings_and_a_longer_one_is_the_links():
    assert link(4, delay_s=0.004).timing.lost.sum() == 0
    early, late = (rms(link(4, delay_s=delay_s).residuals([{}])[0])[0] for delay_s in (0.006, 0.024))
    assert late > 2.0 * early


@pytest.mark.parametrize(("divisor", "has_slopes"), [(1, True), (4, False)])
def test_an_equation_has_slopes_of_commands_only_where_every_pass_has_a_row(divisor, has_slopes):
    found = ResidualModel(read_recording(logged(flight(), divisor), vehicle()))
    names = {name for own in build_features(found, perturbed_variants(vehicle(), ())) for name in own.names}
    assert {"rate sent x", "throttle"} < names
    assert ({"slope of rate sent x", "slope of throttle"} < names) == has_slopes


@pytest.mark.parametrize(("name", "unit"), [("rate sent y", 1.0), ("rate sent y^3", 1.0 / 9.0)])
def test_an_equation_is_no_scale_that_the_rows_may_give(name, unit):
    found = ResidualModel(read_recording(logged(flight(), 10), vehicle()))
    (pitch,) = (channel for channel in found.channels if channel.id == "rate_command_pitch")
    low, high = (-3.0, 3.0) if unit == 1.0 else (-27.0, 27.0)
    error = unit * found.recording.command_link.scale_error()[1]
    for size, of_rows in ((0.9, True), (1.1, False)):
        term = EquationTerm(pitch, name, "", size * error, 0.0, "", low, high, gain=100.0, net_gain=100.0)
        assert is_of_rows(term, (found,)) == of_rows
