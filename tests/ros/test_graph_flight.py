"""The whole graph flies a lap in lockstep, every node in its own process, with images."""

from collections import Counter

import pytest

from swift_ros import configuration
from swift_ros.configuration import configuration_folder
from swift_ros.graph.topic_table import GROUND_TRUTH_SUBSCRIBERS, NODES, TOPICS, full_name
from swift_ros.race.result import BAG
from swift_ros.recording import bags
from swift_ros.recording.race_bag import read_race
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.racing.race import RACERS, Flight, RaceOptions

SEED = 1000


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A lap: its folder, the printed lines, and publishers and subscribers of each topic in flight."""
    lines, publishers, subscribers = [], {}, {}
    options = RaceOptions(configuration_folder(), tmp_path_factory.mktemp("lap"), False, "local", lines.append)
    gates = len(configuration.load(Track, options.config / "track.yaml").gates)
    with Flight(SEED, options) as flight:
        flight.follow(until=lambda: flight.listener.passages >= 3)
        for name in TOPICS:
            publishers[name], subscribers[name] = flight.listener.endpoints(name)
        flight.follow(until=lambda: flight.listener.passages > gates)
        assert flight.listener.passages > gates, lines
    return options.out, lines, publishers, subscribers


def test_only_simulator_recorder_and_race_monitor_subscribe_to_ground_truth(flown):
    _, _, _, subscribers = flown
    assert "race_monitor" in subscribers["ground_truth/odometry"]
    assert set(subscribers["ground_truth/odometry"]) <= set(GROUND_TRUTH_SUBSCRIBERS)


@pytest.mark.parametrize("name", [name for name in TOPICS if name != "/diagnostics"])
def test_the_running_graph_agrees_with_the_table(flown, name):
    _, _, publishers, subscribers = flown
    rows = [NODES[node] for node in RACERS]
    assert set(publishers[name]) == {row.name for row in rows if name in row.publishes}
    # the runner prints the race; the recorder and the race monitor subscribe to all topics
    listeners = {row.name for row in rows if name in row.subscribes}
    assert listeners <= set(subscribers[name]) <= listeners | {"recorder", "race_monitor", "runner"} | _clocked(name)


def _clocked(name):
    return set(RACERS) if name == "/clock" else set()


def test_no_message_is_lost(flown):
    count = Counter(raw.topic for raw in bags.read_raw(flown[0] / BAG))
    images = count[full_name("camera/image_raw")]
    assert images > 100
    for name in ("gates/detections", "gates/poses", "state/updates"):
        assert images - 3 <= count[full_name(name)] <= images
    ticks = count[full_name("vio/raw")]
    for name in ("vio/odometry", "state/odometry", "policy/step", "command/body_rate_thrust", "betaflight/link"):
        assert ticks - 3 <= count[full_name(name)] <= ticks + 3
    assert count[full_name("ground_truth/odometry")] == count["/clock"] == ticks


def test_the_error_of_the_estimate_is_half_of_the_odometrys(flown):
    config = configuration_folder()
    track, vehicle = (
        configuration.load(kind, config / file) for kind, file in ((Track, "track.yaml"), (Vehicle, "drone.yaml"))
    )
    result, _ = read_race(flown[0], track, vehicle)
    assert len(result.laps_s) == 1 and result.laps_s[0] < 9.0
    assert result.state_rmse_m < min(0.2, 0.5 * result.vio_rmse_m)


def test_passages_and_splits_are_printed_in_flight(flown):
    _, lines, _, _ = flown
    splits = [line for line in lines if "split" in line]
    assert len(splits) == 8
    assert "gate 1, lap 1 done, split" in splits[-1] and "margin" in splits[-1]
