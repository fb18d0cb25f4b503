"""Residuals of the command link and of the rate loop."""

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.recording.betaflight_log import RateLoopLog
from swift_sim_bridge.gap.recording.command_timing import Passes
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.gap.residuals.filters import Filter, apply

TIMING_SHARE = 0.25  # of a row: standard deviation of the time between a command and its row (uniform: 0.29)


def command_residuals(recording: Recording, low: Filter, term_sets: list[dict]) -> np.ndarray:
    """Return received minus modelled commands (b, m, 4), rates rad/s and throttle, for the terms of b vehicles."""
    link = recording.command_link
    return _on_grid(recording, low, link.passes, link.residuals(term_sets))


def timing_sensitivity(recording: Recording, low: Filter) -> np.ndarray:
    """Return the change (5, m, 4) of these residuals where a command, last the gyro, is TIMING_SHARE of a row later."""
    link = recording.command_link
    return 2.0 * TIMING_SHARE * _on_grid(recording, low, link.passes, link.timing_change())


def rate_loop_residuals(recording: Recording, low: Filter, vehicles: list[Vehicle]) -> np.ndarray:
    """Return logged minus replayed demand of the rate loop (b, m, 3), share of the motors' range, for b vehicles."""
    log = recording.rate_loop
    return _on_grid(recording, low, log, log.residual(vehicles))


def _on_grid(recording: Recording, low: Filter, passes: Passes | RateLoopLog, values) -> np.ndarray:
    """Return values (b, n, k) of the rate loop's passes as filtered values (b, m, k).

    They change in steps, so that they are averaged over each step of the grid first.
    """
    flat = np.moveaxis(values, 1, 0).reshape(values.shape[1], -1)
    total = np.concatenate([np.zeros((1, flat.shape[1])), np.cumsum(flat, axis=0)]) * passes.step_s
    stamps = np.append(passes.t, passes.t[-1] + passes.step_s)
    begin, end = recording.t - 0.5 * recording.dt, recording.t + 0.5 * recording.dt
    mean = (
        np.stack([np.interp(end, stamps, column) - np.interp(begin, stamps, column) for column in total.T], axis=-1)
        / recording.dt
    )
    return np.moveaxis(apply(low.smooth, mean.reshape(len(mean), len(values), -1)), 1, 0)
