"""Foreign recordings are converted to bags in the frames and units of this graph, without their corrupt data."""

import gzip
import json

import h5py
import numpy as np
import pytest

from swift_ros import cli, geometry
from swift_ros.errors import DamagedRecording, UsageError
from swift_ros.importers import blackbird, nanobench
from swift_ros.messages.motion import from_odometry
from swift_ros.messages.vectors import from_xyz
from swift_ros.recording import bags

N, DT, BEGIN = 600, 0.01, 1.7e9
T = BEGIN + DT * np.arange(N)
RADIUS, RATE = 2.0, 0.8  # a circle, flown forwards: m, rad/s
HELD = np.array([0.02, -0.03, 9.9])  # specific force in the airframe's axes


def circle():
    """Return position, velocity (n, 3) and heading (n,) of a level circle, with measurement noise."""
    angle = RATE * (T - BEGIN)
    position = RADIUS * np.stack([np.cos(angle), np.sin(angle), 0.5 + 0.0 * angle], axis=1)
    velocity = RADIUS * RATE * np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle], axis=1)
    noise = np.random.default_rng(0).normal(scale=1e-5, size=(2, N, 3))
    return position + noise[0], velocity + noise[1], angle + np.pi / 2


def measured(value, seed):
    return np.asarray(value) + np.random.default_rng(seed).normal(scale=1e-3, size=(N, len(value)))


def nanobench_table(folder, change=lambda columns: None):
    """Write a NanoBench recording of the circle; `change` modifies its columns (by name) first."""
    position, velocity, heading = circle()
    attitude = geometry.quaternion_from_yaw(heading)
    columns = {"t": T}
    for names, values in (
        (nanobench.POSITION, position),
        (nanobench.ATTITUDE, attitude),
        (nanobench.VELOCITY, velocity),
        (nanobench.RATES, measured((0, 0, RATE), 1)),
        (nanobench.GYRO, measured((0, 0, RATE), 2)),
        (nanobench.FORCE_G, measured(HELD / nanobench.GRAVITY, 3)),
        (nanobench.MOTORS, 40000 + 1e5 * measured([0] * 4, 4)),
        (nanobench.OWN_POSITION, position + measured((0, 0, 0), 5)),
        (nanobench.OWN_ATTITUDE, attitude),
        (nanobench.OWN_VELOCITY, velocity + measured((0, 0, 0), 6)),
        ((nanobench.VOLTAGE,), measured([4.0], 7)),
    ):
        columns |= dict(zip(names, np.asarray(values).T.copy(), strict=True))
    change(columns)
    path = folder / "B0_circle_rep1.csv.gz"
    with gzip.open(path, "wt") as file:
        np.savetxt(file, np.column_stack([*columns.values()]), "%.9f", ",", header=",".join(columns), comments="")
    return path


def blackbird_folder(folder):
    """Write a Blackbird recording of the circle: the airframe's forward is the IMU's -y, its up the IMU's -z."""
    position, velocity, heading = circle()
    imu = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # rows: airframe axes in the IMU's
    q_body_imu = geometry.quaternion_from_matrix(imu)
    attitude = geometry.quaternion_multiply(geometry.quaternion_from_yaw(heading), q_body_imu)
    poses = np.column_stack([T, position, attitude, velocity])
    folder.mkdir()
    np.savetxt(folder / blackbird.POSES, poses, fmt="%.9f", header="ts x y z qx qy qz qw")
    with h5py.File(folder / blackbird.DATA, "w") as file:
        file["ts"] = np.loadtxt(folder / blackbird.POSES)[:, 0]
        file["gyro_raw"] = measured((0, 0, RATE), 2) @ imu
        file["accel_raw"] = measured(HELD, 3) @ imu
        file["thrust"] = measured((0, 0, -9.81), 4)
    return folder


def imported(capsys, *arguments):
    """Run `swiftros import` and return its exit code and output."""
    code = cli.main(["import", *map(str, arguments)])
    captured = capsys.readouterr()
    return code, captured.out + captured.err


def check_circle(bag):
    """Assert the velocity, rates and specific force of a bag of the circle; return its messages by topic."""
    received = {topic: [] for topic in bags.topic_types(bag)}
    for topic, message, _ in bags.read(bag):
        received[topic].append(message)
    for topic in ("/swift/ground_truth/odometry", "/swift/vio/odometry"):
        states = [from_odometry(message) for message in received[topic]]
        assert len(states) == N
        np.testing.assert_allclose(np.mean([s.v_body for s in states], axis=0), (RADIUS * RATE, 0, 0), atol=1e-3)
        np.testing.assert_allclose(np.mean([s.omega_body for s in states[5:-5]], axis=0), (0, 0, RATE), atol=1e-3)
        assert states[0].stamp_ns == pytest.approx(BEGIN * 1e9, abs=200)
    force = np.mean([from_xyz(m.linear_acceleration) for m in received["/swift/imu/data_raw"]], axis=0)
    np.testing.assert_allclose(force, HELD, atol=1e-2)
    turning = np.mean([from_xyz(m.angular_velocity) for m in received["/swift/imu/data_raw"]], axis=0)
    np.testing.assert_allclose(turning, (0, 0, RATE), atol=1e-3)
    return received


def test_a_nanobench_flight_has_the_right_motion_and_units(tmp_path, capsys):
    code, output = imported(capsys, nanobench_table(tmp_path), "--out", tmp_path / "out")
    assert code == 0 and "rejected" not in output and "own estimate" in output
    received = check_circle(tmp_path / "out" / "B0_circle_rep1")
    rotors = received["/swift/betaflight/rotors"][0]
    assert np.isnan(rotors.speed).all() and rotors.motor[0] == pytest.approx(40000 / 65535, abs=0.01)
    assert len(received["/swift/battery"]) == pytest.approx(10 * N * DT, abs=1)


def test_a_blackbird_flight_is_rotated_from_the_imu_to_the_airframe(tmp_path, capsys):
    code, output = imported(capsys, blackbird_folder(tmp_path / "part"), "--out", tmp_path / "out")
    assert code == 0 and "rejected" not in output and "motion capture played as odometry" in output
    received = check_circle(tmp_path / "out" / "blackbird-part")
    speed = np.array(received["/swift/betaflight/rotors"][0].speed)
    thrust = np.sum((speed * 60 / (2 * np.pi)) ** 2) * blackbird.THRUST_PER_RPM2 / blackbird.MASS
    assert thrust == pytest.approx(9.81, abs=0.01)
    assert "motion capture" in bags.custom_data(tmp_path / "out" / "blackbird-part")["vio/odometry"]


def test_corrupt_samples_are_reported_and_the_others_imported(tmp_path, capsys):
    def damage(columns):
        for name in (*nanobench.GYRO, *nanobench.FORCE_G):  # the radio log ended before the motion capture
            columns[name][500:] = columns[name][500] + 0.01 * np.arange(N - 500)
        columns["motor_motor_m1"][200:210] = -4.8e6
        columns["px"][300] = np.nan

    code, output = imported(capsys, nanobench_table(tmp_path, damage), "--out", tmp_path / "out")
    assert code == 0 and "rejected 2.00 s to 2.09 s, motors: reaches -4.8e+06 PWM" in output
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    found = {row["channel"]: row["time"] for row in result["rejected_data"]}
    assert found["gyro"] == pytest.approx([5.0, 5.99], abs=0.011) and found["motors"] == pytest.approx([2.0, 2.09])
    assert found["motion capture position"] == pytest.approx([3.0, 3.0])
    counts = result["recordings"][0]["messages"]
    assert counts["imu/data_raw"] == 500 and counts["betaflight/rotors"] == N - 10
    assert counts["ground_truth/odometry"] == N - 1
    bag = tmp_path / "out" / "B0_circle_rep1"
    assert sum(1 for _ in bags.read_raw(bag, ["/swift/imu/data_raw"])) == 500


@pytest.mark.parametrize(
    "damage, sentence",
    [
        (lambda path: path.write_bytes(b"no gzip"), "cannot be read"),
        (lambda path: path.write_bytes(gzip.compress(b"t,px\n1,2\n3,4\n")), "lacks the column py"),
        (lambda path: path.write_bytes(path.read_bytes()[:30]), "has no text"),
        (lambda path: path.write_bytes(path.read_bytes()[:-8] + b"12345678"), "cannot be read"),  # another checksum
    ],
)
def test_an_invalid_recording_is_refused_in_one_sentence(tmp_path, capsys, damage, sentence):
    path = nanobench_table(tmp_path)
    damage(path)
    code, output = imported(capsys, path, "--out", tmp_path / "out")
    assert code == 2 and sentence in output and len(output.strip().splitlines()) == 2


def test_a_compressed_table_that_was_cut_is_read_up_to_there(tmp_path, capsys):
    path = nanobench_table(tmp_path)
    whole = nanobench.read_table(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    code, output = imported(capsys, path, "--out", tmp_path / "out")
    assert code == 0 and "the rows after" in output
    with pytest.warns(DamagedRecording, match="the rows after"):
        part = nanobench.read_table(path)
    count = len(part["t"])
    assert len(whole["t"]) / 3 < count < len(whole["t"])
    assert all(np.array_equal(part[name], whole[name][:count], equal_nan=True) for name in whole)


def test_a_folder_without_recordings_is_refused(tmp_path, capsys):
    code, output = imported(capsys, tmp_path)
    assert code == 2 and "holds no recording of blackbird, nanobench, blackbox" in output
    code, output = imported(capsys, tmp_path / "nowhere")
    assert code == 2 and "does not exist" in output


def test_the_poses_of_another_recording_are_refused(tmp_path):
    folder = blackbird_folder(tmp_path / "part")
    np.savetxt(folder / blackbird.POSES, np.loadtxt(folder / blackbird.POSES) + 1.0)
    with pytest.raises(UsageError, match="differ"):
        blackbird.read(folder)


def test_the_corrupt_nanobench_flight_is_rejected_from_the_end_of_its_log(shared_data):
    flight = nanobench.read(shared_data / "nanobench" / "B9_trefoil_fast_rep10.csv.gz")
    by_channel = {rejection.channel: rejection for rejection in flight.rejections}
    for channel in ("gyro", "motors", "own position"):
        assert by_channel[channel].begin_s == pytest.approx(19.2, abs=0.02)
        assert by_channel[channel].end_s == pytest.approx(flight.t[-1] - flight.t[0])
    assert "-2.51367e+06 PWM" in by_channel["motors"].reason
    rows = {stream.topic: int(stream.rows.sum()) for stream in flight.streams}
    assert rows["ground_truth/odometry"] == len(flight.t) and 1900 < rows["imu/data_raw"] < 1925


def test_blackbird_flies_forwards_and_its_imu_agrees_with_motion_capture(shared_data):
    flight = blackbird.read(shared_data / "blackbird" / "test")
    assert not flight.rejections
    streams = {stream.topic: stream for stream in flight.streams}
    rows = range(0, len(flight.t), 10)
    truth = [from_odometry(streams["ground_truth/odometry"].message(i, 0)) for i in rows]
    gyro = [from_xyz(streams["imu/data_raw"].message(i, 0).angular_velocity) for i in rows]
    assert np.mean([state.v_body[0] for state in truth]) > 2.0
    error = np.array(gyro) - np.array([state.omega_body for state in truth])
    assert np.sqrt(np.mean(error**2)) < 0.15
