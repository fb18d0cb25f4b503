"""Bags of ROS 1 and SQLite bags of ROS 2 give the flight that was flown, by a mapping where a type is not known."""

import flown_rosbags
import numpy as np
import pytest
from flown_logs import flight

from swift_ros import cli
from swift_ros.errors import UsageError
from swift_ros.recording import flight_files

MAPPING = """channels:
  gyro_body: {topic: /drone/imu, columns: [angular_velocity.x, angular_velocity.y, angular_velocity.z]}
  specific_force_body:
    {topic: /drone/imu, columns: [linear_acceleration.x, linear_acceleration.y, linear_acceleration.z]}
  p_world: {topic: /vrpn/drone/pose, columns: [pose.position.x, pose.position.y, pose.position.z]}
  q_world_body:
    topic: /vrpn/drone/pose
    columns: [pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w]
  motor_command: {topic: /drone/motors, columns: ["share[0]", "share[1]", "share[2]", "share[3]"]}
"""


@pytest.fixture(scope="module", params=["flight.bag", "sqlite"])
def bag(request, tmp_path_factory):
    return flown_rosbags.write(tmp_path_factory.mktemp("bags") / request.param)


@pytest.fixture
def mapping(tmp_path):
    path = tmp_path / "mapping.yaml"
    path.write_text(MAPPING)
    return path


def test_a_mapping_names_the_topics_of_motors_whose_type_is_not_known(bag, mapping):
    table, flown = flight_files.read(bag, mapping), flight()
    truth = {"p_world": flown.p, "gyro_body": flown.gyro, "specific_force_body": flown.force}
    for channel, values in (truth | {"motor_command": flown.motors}).items():
        np.testing.assert_allclose(table[channel].t, flown.t, atol=2e-6)
        np.testing.assert_allclose(table[channel].values, values, atol=1e-6, err_msg=channel)
    assert not table.contradicted


def test_the_guess_finds_all_but_the_motors_and_writes_every_topic_for_correction(bag, tmp_path, capsys):
    written = tmp_path / "guess.yaml"
    assert cli.main(["import", str(bag), "--write-mapping", str(written)]) == 0
    assert "v_world = /vrpn/drone/twist: twist.linear.x" in capsys.readouterr().out
    assert "/drone/motors" in written.read_text() and "share[3]" in written.read_text()
    with pytest.raises(UsageError, match="no rotor speeds"):
        flight_files.read(bag)


def test_a_bag_that_was_cut_is_refused_with_the_command_that_repairs_it(bag, tmp_path):
    if bag.is_dir():
        cut = tmp_path / "cut"
        cut.mkdir()
        for file in bag.iterdir():
            content = file.read_bytes()
            (cut / file.name).write_bytes(content if file.suffix == ".yaml" else content[: len(content) // 3])
    else:
        cut = tmp_path / "cut.bag"
        cut.write_bytes(bag.read_bytes()[: bag.stat().st_size // 3])
    with pytest.raises(UsageError, match=r"cut.* cannot be read as a ROS . bag.*reindex"):
        flight_files.read(cut)


def test_a_database_without_its_description_is_refused_with_the_command_that_writes_it(bag, tmp_path):
    if not bag.is_dir():
        pytest.skip("a bag of ROS 1 is one file")
    database = next(bag.glob("*.db3"))
    alone = tmp_path / database.name
    alone.write_bytes(database.read_bytes())
    with pytest.raises(UsageError, match="has no metadata.yaml; write it with `ros2 bag reindex"):
        flight_files.read(alone)
