"""The picture of a race: a crash at a known place, gates of known sizes and attitudes, and what must not be covered."""

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure

from swift_ros import configuration
from swift_ros.race.judge import RaceEvent
from swift_ros.race.result import RaceRecord, result_of
from swift_ros.track import Gate, Track
from swift_ros.types import BodyRateThrust, Odometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.plots.track import draw_gates
from swift_sim_bridge.racing import picture

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
GATES = (Gate((5.0, 0.0, 2.0), 0.0), Gate((-5.0, 3.0, 4.0), 180.0))
TRACK = Track("ring", GATES, 1.5, 2.1, 0.1, (0.0, 0.0, 2.0), 0.0, 1, (-20.0, -20.0, 0.0), (20.0, 20.0, 9.0))
SPEED = 4.0


@pytest.fixture(scope="module")
def vehicle(repository):
    return configuration.load(Vehicle, repository / "config" / "drone.yaml")


def flight(y_m: float) -> RaceRecord:
    """Return a race along x for 2.5 s, at a distance y from the centre of the first gate."""
    v = np.array([SPEED, 0.0, 0.0])
    stamps = [i * 10_000_000 for i in range(250)]
    poses = [Odometry(ns, np.array([SPEED * 1e-9 * ns, y_m, 2.0]), LEVEL, v, np.zeros(3)) for ns in stamps]
    odometry = {"ground_truth/odometry": poses, "state/odometry": poses, "vio/odometry": poses}
    commands = [BodyRateThrust(ns, 11.0) for ns in stamps]
    return RaceRecord(odometry, [RaceEvent(0, "racing")], 0, None, commands, [(ns, 16.0) for ns in stamps[::10]])


def composed(record: RaceRecord, vehicle: Vehicle) -> Figure:
    figure = picture.compose(record, result_of(record, TRACK, vehicle, {"seed": 7}), TRACK, vehicle)
    figure.canvas.draw()
    return figure


def end_marks(axes):
    return [line for line in axes.lines if line.get_marker() == "X"]


def test_a_crash_is_marked_where_the_gate_was_touched_and_says_which(vehicle):
    figure = composed(flight(0.75), vehicle)  # into the left bar of the gate at x = 5
    above, side, *panels = figure.axes
    for axes, vertical in ((above, 0.75), (side, 2.0)):
        ((x, y),) = end_marks(axes)[0].get_xydata()
        assert x == pytest.approx(5.0 - 0.05 - vehicle.hull_radius, abs=0.06) and y == pytest.approx(vertical)
    assert any("touched gate 1" in text.get_text() for text in above.texts)
    assert "touched gate 1" in figure.get_suptitle()
    ended_s = (5.0 - 0.05 - vehicle.hull_radius) / SPEED
    for axes in panels:
        if axes.get_ylabel():
            assert any(np.allclose(line.get_xdata(), ended_s, atol=0.03) for line in axes.lines), axes.get_ylabel()


def test_the_text_of_the_end_covers_neither_gates_nor_the_path(vehicle):
    figure = composed(flight(0.75), vehicle)
    above = figure.axes[0]
    (text,) = (text for text in above.texts if "touched" in text.get_text())
    box = text.get_window_extent()
    path = np.array([[x, 0.75] for x in np.linspace(0, 4.7, 50)])
    for point in above.transData.transform(np.concatenate([path, TRACK.corners[..., :2].reshape(-1, 2)])):
        assert not box.contains(*point)


def test_a_race_that_goes_on_has_no_crash_but_thrust_and_battery(vehicle):
    figure = composed(flight(0.0), vehicle)
    labels = {axes.get_ylabel(): axes for axes in figure.axes}
    thrust, battery = labels["thrust [m/s²]"], labels["battery [V]"]
    assert set(thrust.lines[0].get_ydata()) == {11.0} and set(battery.lines[0].get_ydata()) == {16.0}


def test_no_legend_covers_a_gate_and_the_speed_is_wider_than_the_estimate(vehicle):
    figure = composed(flight(0.0), vehicle)
    for axes in figure.axes[:2]:
        legend = axes.get_legend()
        assert legend is None or not legend.get_window_extent().overlaps(axes.get_window_extent().shrunk(0.99, 0.99))
        (speeds,) = axes.collections
        assert speeds.get_linewidth()[0] > 3 * max(line.get_linewidth() for line in axes.lines[:2])


def test_gates_are_drawn_with_their_own_attitudes_and_sizes():
    flat = Gate((1.0, 2.0, 3.0), 0.0, pitch_deg=90.0, inner_side=1.0, outer_side=3.0)  # flown downwards
    rolled = Gate((8.0, 2.0, 3.0), 90.0, roll_deg=45.0, inner_side=2.0, outer_side=2.4)
    track = Track("tilted", (flat, rolled), 1.5, 2.1, 0.1, (0, 0, 0), 0.0, 1, (-20, -20, 0), (20, 20, 9))
    axes = Figure().add_subplot()
    draw_gates(axes, track, 0, 1)
    rings = [line.get_xydata() for line in axes.lines if len(line.get_xydata()) == 5]
    spans = [np.ptp(ring, axis=0).tolist() for ring in rings]
    # from above: the first a whole square; the second a line, whose length is the diagonal of its opening
    assert np.allclose(spans, [[1, 1], [3, 3], [np.sqrt(8), 0], [2.4 * np.sqrt(2), 0]], atol=1e-9)
    ends = [line.get_marker() for line in axes.lines if len(line.get_xydata()) == 1]
    assert ends == ["x"]  # only the first is passed away from the viewer
    assert [text.get_text() for text in axes.texts if text.get_text()] == ["1", "2"]


def test_the_file_is_small_and_has_the_colors_of_crash_and_speed(vehicle, tmp_path):
    record = flight(0.75)
    picture.draw(record, result_of(record, TRACK, vehicle, {"seed": 7}), TRACK, vehicle, tmp_path / "flight.png")
    assert (tmp_path / "flight.png").stat().st_size < 200_000
    image = cv2.imread(str(tmp_path / "flight.png")).astype(int)
    red = np.abs(image - [28, 25, 215]).max(axis=-1) < 20
    assert red.sum() > 500
