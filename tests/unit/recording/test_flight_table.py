"""A recorded flight as a table: what was measured comes back, what cannot be is named, what is missing is said."""

import gzip
import json
import sys

import numpy as np
import pytest

from swift_ros import cli, geometry, messages
from swift_ros.camera.model import Camera
from swift_ros.configuration import configuration_folder, load
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.recording import flight_files
from swift_ros.recording.bags import BagWriter
from swift_ros.recording.flight_table import CHANNELS, known_columns
from swift_ros.track import Track
from swift_ros.types import BodyRateThrust, GateCorners, Odometry

RATE = 200.0
N = 400


def flight(n=N, rate=RATE):
    """Return the columns of two seconds of a weaving flight with four rotors."""
    t = np.arange(n) / rate
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((40, n))
    heading = geometry.quaternion_from_yaw(np.sin(t) + 1e-3 * noise[0])
    columns = {"t": t}
    for i, name in enumerate(known_columns()[1:]):
        if name.startswith("q"):
            columns[name] = heading[:, "xyzw".index(name[1])].copy()
        elif name.startswith("vio_q"):
            columns[name] = heading[:, "xyzw".index(name[-1])].copy()
        elif name.startswith(("rotor_", "u_")):
            if int(name.split("_")[1]) <= 4:
                scale = 2000.0 if name.startswith("rotor_") else 1.0
                columns[name] = scale * (0.5 + 0.1 * np.sin(t * i) + 0.01 * noise[i % 40])
        else:
            columns[name] = 9.0 + np.sin(t * i) + 0.01 * noise[i % 40]
    return columns


def write_csv(path, columns):
    np.savetxt(path, np.column_stack([*columns.values()]), "%.12g", ",", header=",".join(columns), comments="")
    return path


def test_a_table_comes_back_whatever_the_order_of_its_columns(tmp_path):
    columns = flight()
    shuffled = {name: columns[name] for name in sorted(columns, reverse=True)}
    table = flight_files.read(write_csv(tmp_path / "flight.csv", shuffled))
    assert set(table.channels) == set(CHANNELS) and not table.rejections
    np.testing.assert_allclose(table["rotor_speed"].values[:, 2], columns["rotor_3"])
    np.testing.assert_allclose(table["voltage"].values, columns["vbat"])
    assert table["gyro_body"].rate_hz == pytest.approx(RATE) and table.span_s == pytest.approx((0.0, (N - 1) / RATE))
    flight_files.write(table, tmp_path / "again.csv")
    again = flight_files.read(tmp_path / "again.csv")
    for channel, samples in table.channels.items():
        np.testing.assert_allclose(again[channel].values, samples.values, rtol=1e-9)
        np.testing.assert_allclose(again[channel].t, samples.t)


def test_a_channel_slower_than_the_table_keeps_its_own_stamps(tmp_path):
    columns = flight()
    for name in ("vbat", "ibat"):
        columns[name][np.arange(N) % 20 != 0] = np.nan
    columns = {name: values for name, values in columns.items() if not name.startswith("vio")}
    text = write_csv(tmp_path / "flight.csv", columns).read_text().replace("nan", "")  # an empty field is none either
    (tmp_path / "flight.csv").write_text(text)
    table = flight_files.read(tmp_path / "flight.csv")
    assert table["voltage"].rate_hz == pytest.approx(10.0) and len(table["p_world"].t) == N
    assert "p_vio" not in table
    with pytest.raises(UsageError, match="lacks vio_px, vio_py, vio_pz"):
        table.require("p_vio")


def test_times_need_not_be_uniform(tmp_path):
    columns = flight()
    columns["t"] = columns["t"] + np.random.default_rng(1).uniform(-0.4, 0.4, N) / RATE
    table = flight_files.read(write_csv(tmp_path / "flight.csv", columns))
    np.testing.assert_allclose(table["p_world"].t, columns["t"], atol=1e-9)


def test_what_is_no_measurement_is_named_and_left_out(tmp_path):
    columns = flight()
    columns["ax"][100:140] = columns["ax"][100] + 0.01 * np.arange(40)
    columns["ay"][100:140] = columns["az"][100:140] = 9.81
    columns["u_2"][200] = 4.8
    columns["qw"][300] = 0.0
    columns["t"][350] = columns["t"][349]
    table = flight_files.read(write_csv(tmp_path / "flight.csv", columns))
    told = {rejection.channel: rejection for rejection in table.rejections}
    assert set(told) == {"specific_force_body", "motor_command", "q_world_body", "t"}
    assert (told["specific_force_body"].begin_s, told["specific_force_body"].end_s) == pytest.approx((0.5, 0.695))
    assert "4.8" in told["motor_command"].reason and "length" in told["q_world_body"].reason
    assert len(table["specific_force_body"].t) == N - 41 and len(table["p_world"].t) == N - 1


@pytest.mark.parametrize(("row", "time"), [(0, 0.0), (200, 9e12), (0, np.nan), (300, -1.7e6)])
def test_a_time_of_another_clock_is_left_out_and_named_where_it_lies(tmp_path, row, time):
    columns = flight()
    columns["t"] += 1.7e6
    columns["t"][row] = time
    table = flight_files.read(write_csv(tmp_path / "flight.csv", columns))
    (told,) = (one for one in table.rejections if "nothing was recorded" not in one.reason)
    assert told.channel == "t" and told.begin_s == told.end_s == (1.7e6 + 0.005 if np.isnan(time) else time)
    assert len(table["p_world"].t) == N - 1 and table.span_s[1] - table.span_s[0] < 3.0


def test_times_that_run_backwards_are_named_with_their_span(tmp_path):
    columns = flight()
    columns["t"][200:210] -= 0.5
    (told,) = (
        one
        for one in flight_files.read(write_csv(tmp_path / "flight.csv", columns)).rejections
        if "do not follow" in one.reason
    )
    assert (told.begin_s, told.end_s) == pytest.approx((0.5, 0.545))


def test_a_gyro_that_ends_at_its_range_is_left_out_there_and_no_other_peak_is(tmp_path):
    columns = flight(n=2000)
    columns["wx"] = 20.0 * np.sin(3.0 * columns["t"]) + 0.05 * np.random.default_rng(1).standard_normal(2000)
    for whole in (columns["wx"], np.round(columns["wx"] / 0.05) * 0.05, np.repeat(columns["wx"][::5], 5)):
        table = flight_files.read(write_csv(tmp_path / "whole.csv", columns | {"wx": whole}))
        assert not table.rejections
    cut = np.clip(np.round(columns["wx"] / 0.001) * 0.001, -17.453, 17.453)
    table = flight_files.read(write_csv(tmp_path / "cut.csv", columns | {"wx": cut}))
    assert {one.channel for one in table.rejections} == {"gyro_body"} and len(table.rejections) >= 10
    assert all("greatest or least of its values: clipped" in one.reason for one in table.rejections)
    assert np.abs(table["gyro_body"].values[:, 0]).max() < 17.453


def test_a_pose_that_stands_still_while_the_gyro_turns_is_frozen_and_one_at_rest_is_not(tmp_path):
    columns = flight(n=1000)
    pose = [name for name in columns if name in ("px", "py", "pz", "vx", "vy", "vz", "qx", "qy", "qz", "qw")]
    held = {name: np.where(np.arange(1000) // 100 == 5, columns[name][500], columns[name]) for name in pose}
    table = flight_files.read(write_csv(tmp_path / "frozen.csv", columns | held))
    told = {one.channel: one for one in table.rejections}
    assert set(told) == {"p_world", "q_world_body", "v_world"}
    assert all((one.begin_s, one.end_s) == pytest.approx((2.505, 2.995)) for one in told.values())
    assert all(one.reason == "stands still while the gyro turns: frozen" for one in told.values())
    rest = {name: np.full(1000, columns[name][500]) for name in pose}
    noise = np.random.default_rng(2).standard_normal((3, 1000))
    rest |= {f"w{axis}": 0.1 + 0.2 * noise[i] for i, axis in enumerate("xyz")}
    assert not flight_files.read(write_csv(tmp_path / "rest.csv", columns | rest)).rejections


def test_a_rotor_that_keeps_its_speed_while_its_command_changes_is_frozen_and_one_at_idle_is_not(tmp_path):
    columns = flight(n=1000)
    columns["u_2"] = 0.5 + 0.3 * np.sin(5.0 * columns["t"])
    held = np.where(np.arange(1000) // 100 == 5, columns["rotor_2"][500], columns["rotor_2"])
    (told,) = flight_files.read(write_csv(tmp_path / "frozen.csv", columns | {"rotor_2": held})).rejections
    assert (told.begin_s, told.end_s) == pytest.approx((2.505, 2.995)) and told.channel == "rotor_speed"
    assert told.reason == "stands still while the commands change: frozen"
    idle = columns | {"u_2": np.full(1000, 0.05), "rotor_2": np.full(1000, 400.0)}
    assert not flight_files.read(write_csv(tmp_path / "idle.csv", idle)).rejections


def without(*names):
    return lambda columns: [columns.pop(name) for name in list(columns) if name.startswith(names)]


def scaled(names, factor):
    return lambda columns: columns.update({name: columns[name] * factor for name in columns if name.startswith(names)})


def renamed(old, new):
    return lambda columns: columns.update({new: columns.pop(old)})


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (renamed("rotor_2", "rotr_2"), "unknown column 'rotr_2'; the nearest known one is 'rotor_2'"),
        (renamed("cmd_thrust", "thrust_cmd"), "unknown column 'thrust_cmd'"),
        (without("t"), "lacks the column t"),
        (without("wy"), "has wx, wz but lacks wy"),
        (without("u_1"), "lacks u_1"),
        (without("px", "py", "pz", "ax", "ay", "az"), "neither a pose"),
        (without("rotor", "u_", "cmd_thrust"), "no rotor speeds"),
        (lambda columns: columns.update(t=columns["t"] * 5), "come at 40 Hz"),
        (lambda columns: columns.update(t=columns["t"] / 20), "come at 4000 Hz"),
        (lambda columns: columns.update(t=columns["t"] * 1000), "is t in milliseconds, not seconds?"),
        (
            lambda columns: columns.update(t=columns["t"][::-1]),
            "nothing is left of px, py, pz: 399 times do not follow",
        ),
        (scaled("vbat", 1000.0), "vbat are beyond the possible 0.001 to 120 V in 100%"),
        (scaled("vbat", 1000.0), "a flight table is in SI units; are they in millivolts?"),
        (scaled("ibat", 1000.0), "a flight table is in SI units; are they in milliamperes?"),
        (scaled("u_3", 100.0), "beyond the possible -1e-06 to 1 in 100% of the rows"),
        (scaled("u_", 100.0), "a flight table is in SI units; are they in percent?"),
        (scaled("w", 180.0 / np.pi), "a flight table is in SI units; are they in degrees a second?"),
        (scaled("cmd_w", 180.0 / np.pi), "a flight table is in SI units; are they in degrees a second?"),
        (scaled("w", 1e7), "up to 1.0"),
        (
            lambda columns: columns.update(px=np.full(N, np.nan), ax=np.full(N, np.nan)),
            "px, py, pz: no row holds a number",
        ),
    ],
)
def test_what_is_no_flight_is_refused_in_one_sentence(tmp_path, change, sentence):
    columns = flight()
    change(columns)
    with pytest.raises(UsageError) as error:
        flight_files.read(write_csv(tmp_path / "flight.csv", columns))
    assert sentence in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("t,px\n0,1\n1,oops\n", "line 3, column px: 'oops' is no number"),
        ("t,px\n0,1\n1\n", "line 3 has 1 fields"),
        ("t,t\n0,1\n1,2\n", "two columns named 't'"),
        ("t,px\n", "no two rows"),
        ("t;px\n0;1\n1;2\n", "separates its columns by ';'; write ','"),
        ("t,px,\n0,1,\n1,2,\n", "no name for column 3 of 3"),
        ("t,px\n0,1\n1,2\n2,caf\udce9\n", "cannot be read as text"),
        ('t,px\n0,1\n1,2\n2,"' + 150_000 * "3", "line 4 cannot be read: field larger than"),
    ],
)
def test_a_broken_file_is_named_with_its_line(tmp_path, text, sentence):
    (tmp_path / "flight.csv").write_text(text, errors="surrogateescape")
    with pytest.raises(UsageError, match=sentence):
        flight_files.read(tmp_path / "flight.csv")


@pytest.mark.parametrize("missing", [False, True], ids=["whole", "with an empty field"])
def test_a_table_that_a_spreadsheet_wrote_is_read_like_any_other(tmp_path, missing):
    path = write_csv(tmp_path / "flight.csv", flight())
    first, *rows = path.read_text().splitlines()
    rows[5] = rows[5][: rows[5].rindex(",") + 1] if missing else rows[5]
    path.write_text("\n".join([first, *rows]), encoding="utf-8-sig")
    assert len(flight_files.read(path)["p_world"].t) == N - missing * (first.split(",")[-1] == "pz")


def test_what_is_no_table_is_refused(tmp_path):
    (tmp_path / "flight.txt").write_text("hello")
    with pytest.raises(UsageError, match="neither .csv, .parquet nor .mcap"):
        flight_files.read(tmp_path / "flight.txt")
    (tmp_path / "flight.bbl").write_bytes(b"")
    with pytest.raises(UsageError, match="`swiftros import .*flight.bbl` makes bags of it"):
        flight_files.read(tmp_path / "flight.bbl")
    with pytest.raises(UsageError, match="does not exist"):
        flight_files.read(tmp_path / "nowhere.csv")


def test_a_meter_that_is_not_ready_yet_is_left_out_until_it_is(tmp_path):
    columns = flight()
    columns["vbat"][:5] = 0.0
    table = flight_files.read(write_csv(tmp_path / "flight.csv", columns))
    (told,) = table.rejections
    assert told.channel == "voltage" and told.end_s == pytest.approx(4 / RATE)
    assert table["voltage"].t[0] == pytest.approx(5 / RATE)


def test_parquet_comes_back_or_says_what_it_needs(tmp_path, monkeypatch):
    table = flight_files.read(write_csv(tmp_path / "flight.csv", flight()))
    with monkeypatch.context() as without_pyarrow:
        without_pyarrow.setitem(sys.modules, "pyarrow", None)
        with pytest.raises(UsageError, match="needs pyarrow"):
            flight_files.write(table, tmp_path / "flight.parquet")
    pytest.importorskip("pyarrow", reason="pyarrow, which is optional, is not installed")
    flight_files.write(table, tmp_path / "flight.parquet")
    again = flight_files.read(tmp_path / "flight.parquet")
    np.testing.assert_array_equal(again["p_world"].values, table["p_world"].values)
    import pyarrow
    import pyarrow.parquet

    pyarrow.parquet.write_table(pyarrow.table({"t": [], "px": []}), tmp_path / "empty.parquet")
    with pytest.raises(UsageError, match="has a header and no rows"):
        flight_files.read(tmp_path / "empty.parquet")


def record(folder, told, stamps_ns, noted=None):
    """Write a bag of messages by topic: functions of the index of a stamp, and how many stamps lie between two. noted:
    beside the messages."""
    writer = BagWriter(folder, noted)
    for topic, (_, _) in told.items():
        writer.add_topic(full_name(topic), TOPICS[topic].type)
    for k, stamp_ns in enumerate(stamps_ns):
        for topic, (every, message) in told.items():
            if k % every == 0:
                writer.write(full_name(topic), messages.serialize(message(k, int(stamp_ns))), int(stamp_ns))
    writer.close()


def test_a_bag_of_this_graph_is_a_flight_but_its_estimate_is_not(tmp_path):
    columns = flight()
    q = np.stack([columns[name] for name in ("qx", "qy", "qz", "qw")], axis=-1)
    v_world = np.stack([columns[name] for name in ("vx", "vy", "vz")], axis=-1)
    v_body = geometry.rotate_inverse(q, v_world)
    rotors = np.stack([columns[f"rotor_{i}"] for i in range(1, 5)], axis=-1)
    p = np.stack([columns[name] for name in ("px", "py", "pz")], axis=-1)

    def odometry(k, stamp_ns):
        return messages.to_odometry(Odometry(stamp_ns, p[k], q[k], v_body[k], np.zeros(3)), "map")

    stamps_ns = 1_700_000_000_000_000_000 + np.round(columns["t"] * 1e9).astype(np.int64)
    told = {
        "ground_truth/odometry": (1, odometry),
        "betaflight/rotors": (2, lambda k, t: messages.to_rotors(t, rotors[k], [])),
        "battery": (20, lambda k, t: messages.to_battery(t, 15.5 - 1e-3 * k, 40.0 + 1e-3 * k * k, 0.1, 1.55)),
        "command/body_rate_thrust": (1, lambda k, t: messages.to_command(BodyRateThrust(t, 9.0 + k % 3))),
    }
    record(tmp_path / "imported", told, stamps_ns, {"imported": json.dumps([*told])})
    table = flight_files.read(tmp_path / "imported")
    np.testing.assert_allclose(table["v_world"].values, v_world, atol=1e-9)
    np.testing.assert_allclose(table["rotor_speed"].t, columns["t"][::2], atol=1e-9)
    np.testing.assert_allclose(table["rotor_speed"].values, rotors[::2])
    assert "motor_command" not in table and table["current"].values[1] == pytest.approx(40.4)
    assert not table.skips_commands
    record(tmp_path / "beside", told, stamps_ns, {"imported": '["betaflight/rotors"]'})  # a log's motors, our own rest
    beside = flight_files.read(tmp_path / "beside")
    assert not beside.skips_commands and "v_world" not in beside and len(beside["voltage"].t) < len(table["voltage"].t)
    record(tmp_path / "judging_itself", {"state/odometry": (1, odometry), **dict([*told.items()][1:])}, stamps_ns)
    with pytest.raises(UsageError, match="neither a pose"):
        flight_files.read(tmp_path / "judging_itself")


def test_a_flight_controllers_slow_meters_are_read_as_if_they_were_quick(tmp_path):
    """Betaflight tells voltage and current behind low-passes of half a second and a sixth; a tired pack behind them
    would look like another pack."""
    dt = 0.005
    t = dt * np.arange(4000)
    truth = {"voltage": 15.5 - 0.5 * np.sin(2.0 * t), "current": 50.0 + 30.0 * np.sin(3.0 * t)}
    shown = {name: np.empty(len(t)) for name in truth}
    for name, period in (("voltage", 3.0), ("current", 1.0)):  # vbat_display_lpf_period 30, ibat_lpf_period 10
        kept, at = np.exp(-2.0 * np.pi * dt / period), truth[name][0]
        for k, value in enumerate(truth[name]):
            shown[name][k] = at = kept * at + (1.0 - kept) * value
    told = {
        "ground_truth/odometry": (
            1,
            lambda k, stamp_ns: messages.to_odometry(
                Odometry(stamp_ns, [0, 0, 1 + 0.1 * t[k]], [0, 0, 0, 1], np.full(3, 7.0), np.zeros(3)), "map"
            ),
        ),
        "betaflight/rotors": (2, lambda k, stamp_ns: messages.to_rotors(stamp_ns, 900 + t[k] * np.ones(4), [0.4] * 4)),
        "battery": (
            20,
            lambda k, stamp_ns: messages.to_battery(stamp_ns, shown["voltage"][k], shown["current"][k], 0.1, 1.55),
        ),
    }
    record(tmp_path / "bag", told, np.round(t * 1e9).astype(np.int64))
    table = flight_files.read(tmp_path / "bag")
    for name, error in (("voltage", 0.01), ("current", 0.5)):
        there = np.interp(table[name].t, t, truth[name])
        assert np.abs(table[name].values - there).max() < error
        assert np.abs(np.interp(table[name].t, t, shown[name]) - there).max() > 10 * error  # as the meter shows it
    assert table.skips_commands  # it polls a loop of kilohertz a hundred times a second
    assert "v_world" not in table  # follows from the position


def test_gates_in_a_bags_images_come_with_the_camera_and_the_map_that_it_notes(tmp_path):
    stamps_ns = np.arange(0, N) * 5_000_000
    seen = np.arange(8.0).reshape(4, 2)

    def odometry(k, stamp_ns):
        return messages.to_odometry(Odometry(stamp_ns, np.zeros(3), [0, 0, 0, 1], np.zeros(3), np.zeros(3)), "map")

    def detections(k, stamp_ns):
        gates = [GateCorners(seen + k + i, np.ones(4)) for i in range(2)]
        return messages.to_detections(odometry(k, stamp_ns).header, gates if k else [])

    told = {
        "ground_truth/odometry": (1, odometry),
        "gates/detections": (10, detections),
        "command/body_rate_thrust": (1, lambda k, t: messages.to_command(BodyRateThrust(t, 9.0))),
    }
    folder = configuration_folder()
    noted = {f"config/{name}.yaml": (folder / f"{name}.yaml").read_text() for name in ("camera", "track")}
    record(tmp_path / "noted", told, stamps_ns, noted)
    table = flight_files.read(tmp_path / "noted")
    assert table.detected_gates.t[:4] == pytest.approx([0.05, 0.05, 0.1, 0.1])
    np.testing.assert_array_equal(table.detected_gates.corners[1], seen + 11)
    assert table.detected_gates.camera == load(Camera, folder / "camera.yaml")
    assert table.detected_gates.track == load(Track, folder / "track.yaml")
    record(tmp_path / "bare", told, stamps_ns)
    assert flight_files.read(tmp_path / "bare").detected_gates is None


def test_an_imported_nanobench_flight_is_a_table_and_keeps_its_rejections(tmp_path, shared_data):
    with gzip.open(shared_data / "nanobench" / "B2_circle_slow_rep2.csv.gz", "rt") as file:
        lines = file.readlines()
    with gzip.open(tmp_path / "end.csv.gz", "wt") as file:
        file.writelines([lines[0], *lines[-500:]])
    assert cli.main(["import", str(tmp_path / "end.csv.gz"), "--out", str(tmp_path / "out")]) == 0
    table = flight_files.read(tmp_path / "out")
    assert {"p_world", "gyro_body", "motor_command", "voltage"} < set(table.channels)
    assert "rotor_speed" not in table and any(rejection.channel == "gyro" for rejection in table.rejections)
