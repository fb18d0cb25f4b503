"""Results of races as text for the terminal."""

import numpy as np

from swift_ros.race.result import RaceResult
from swift_ros.text import align

HEADINGS = ("seed", "end", "gates", "time s", "laps s", "margin m", "state m", "VIO m", "T/W")


def races(results: list[RaceResult]) -> str:
    """Return a table with a row for each race: end, gates, times, margin, RMSE of state and VIO, thrust-to-weight."""
    return align([HEADINGS, *(_row(result) for result in results)])


def totals(results: list[RaceResult]) -> str:
    """Return one line: number of finished races, median and best lap, RMSE over all races."""
    laps = [lap for result in results for lap in result.laps_s]
    line = f"{sum(result.finished for result in results)} of {len(results)} finished"
    if laps:
        line += f"; laps: median {np.median(laps):.2f} s, best {min(laps):.2f} s"
    errors = [(result.state_rmse_m, result.vio_rmse_m) for result in results if result.state_rmse_m is not None]
    if errors and all(vio is not None for _, vio in errors):
        state, vio = np.sqrt(np.mean(np.square(errors), axis=0))
        line += f"; RMSE: state {state:.3f} m, VIO {vio:.2f} m"
    return line


def _row(result: RaceResult) -> tuple[str, ...]:
    thrust = result.thrust_to_weight
    return (
        str(result.seed),
        result.end if result.finished else f"{result.end}: {result.crash}",
        str(result.gates_passed),
        _number(result.time_s, 2),
        " ".join(f"{lap:.2f}" for lap in result.laps_s) or "-",
        _number(result.min_gate_margin_m, 2),
        _number(result.state_rmse_m, 3),
        _number(result.vio_rmse_m, 2),
        f"{thrust[0]:.2f} to {thrust[1]:.2f}" if thrust else "-",
    )


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
