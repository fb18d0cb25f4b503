"""The gap tool's command layer: motor commands show which commands a rate loop received, late, or not at all."""

from dataclasses import replace

import numpy as np
import pytest
from rate_loop_flight import flight, rms, vehicle

from swift_ros.recording.flight_table import Samples
from swift_sim_bridge.gap.recording import command_link, rate_pid
from swift_sim_bridge.gap.recording.recording import read_recording


def link(**errors) -> command_link.CommandLink:
    return command_link.read_command_link(flight(**errors), rate_pid.rate_pid_from_vehicle(vehicle()))


def test_a_firmware_computes_with_its_own_mass_and_not_with_a_repaired_one():
    heavier = replace(vehicle(), mass=1.1 * vehicle().mass)
    throttle = [
        rms(read_recording(flight(), heavier, loop).command_link.residuals([{}])[0])[3]
        for loop in (rate_pid.rate_pid_from_vehicle(vehicle()), None)
    ]
    assert throttle[0] < 1e-6 < 0.01 < throttle[1]


def test_the_inverted_loop_gives_every_command_that_it_received():
    nominal = link()
    assert nominal.passes.observable.mean() > 0.8 and not nominal.timing.lost.any()
    assert np.all(rms(nominal.residuals([{}])[0]) < 1e-6)


@pytest.mark.parametrize(
    "planted, terms",
    [
        ({"delay_s": 0.012}, {"command_latency": {"delay": 0.012}}),
        (
            {"scale": (1.0, 1.05, 1.0), "offset": 0.02},
            {"rate_scale": {"scale": [1.0, 1.05, 1.0], "offset": [0.02] * 3}},
        ),
        ({"gain": -0.05}, {"throttle_curve": {"gain": -0.05}}),
    ],
)
def test_delayed_or_distorted_commands_agree_with_the_simulators_terms(planted, terms):
    found = link(**planted)
    assert rms(found.residuals([{}])[0]).max() > 3e-3
    assert np.all(rms(found.residuals([terms])[0]) < 2e-3)


def test_lost_commands_are_distinguished_from_late_ones():
    found = link(lost=0.05, delay_s=0.006)
    assert found.timing.lost.mean() == pytest.approx(0.05, abs=0.02)
    terms = {"command_latency": {"delay": 0.006}, "dropped_commands": {"share": float(found.timing.lost.mean())}}
    assert np.all(rms(found.residuals([terms])[0]) < 0.2 * rms(found.residuals([{}])[0]))


@pytest.mark.parametrize("delay_s, jitter_s", [(0.012, 0.002), (0.02, 0.005), (0.0, 0.004)])
def test_commands_with_jitter_are_not_lost(delay_s, jitter_s):
    found = link(delay_s=delay_s, jitter_s=jitter_s)
    assert not found.timing.lost.any()
    assert found.timing.jitter_s == pytest.approx(jitter_s, abs=3e-4)
    late = {"delay": delay_s, "jitter": found.timing.jitter_s}
    assert np.all(rms(found.residuals([{"command_latency": late}])[0]) < 0.3 * rms(found.residuals([{}])[0]))


def test_lost_commands_are_found_among_commands_with_jitter():
    found = link(delay_s=0.012, jitter_s=0.002, lost=0.05)
    assert found.timing.lost.sum() / found.timing.distinct.sum() == pytest.approx(0.05, abs=0.02)
    assert found.timing.jitter_s == pytest.approx(0.002, abs=3e-4)


def test_nothing_is_observable_before_the_first_command_and_in_a_pause():
    whole = flight()
    sent = whole["omega_command_body"].t
    kept = (sent > 2.0) & ~((sent > 5.0) & (sent < 6.0))
    cut = {name: Samples(sent[kept], whole[name].values[kept]) for name in ("omega_command_body", "thrust_command")}
    found = command_link.read_command_link(
        replace(whole, channels={**whole.channels, **cut}), rate_pid.rate_pid_from_vehicle(vehicle())
    )
    t, left = found.passes.t, found.residuals([{}])[0]
    assert not found.passes.observable[(t < 2.0) | ((t > 5.1) & (t < 6.0))].any() and not found.timing.lost.any()
    assert np.abs(left).max() < 0.2


def test_a_loop_of_another_type_is_reported():
    other = replace(vehicle(), controller={"type": "betaflight"})
    assert "rate_pid" in command_link.read_command_link(flight(), rate_pid.rate_pid_from_vehicle(other)).reason
