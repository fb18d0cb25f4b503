"""A wrong unit, frame or order of columns in a table is named with the line of the mapping that corrects it."""

import flown_logs
import numpy as np
import pytest
import yaml

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.recording import flight_files
from swift_ros.recording.log_mapping import mapping_file, reading

AXES = "x", "y", "z"


def changed(groups: dict) -> dict[str, np.ndarray]:
    """Return the flight's columns with other values of some groups; a group has the columns NAME_x, NAME_y .."""
    columns = flown_logs.columns()
    for name, values in groups.items():
        for i, axis in enumerate("xyzw"[: values.shape[1]]):
            columns[f"{name}_{axis}"] = values[:, i]
    return columns


def in_degrees():
    return changed({"gyro": np.degrees(flown_logs.flight().gyro)}), "gyro_body", {"unit": "deg/s"}


def in_g():
    return changed({"acc": flown_logs.flight().force / flown_logs.GRAVITY}), "specific_force_body", {"unit": "g"}


def pointing_down():
    return changed({"acc": flown_logs.flight().force * flown_logs.FRD}), "specific_force_body", {"body": "FRD"}


def gyro_frd():
    return changed({"gyro": flown_logs.flight().gyro * flown_logs.FRD}), "gyro_body", {"body": "FRD"}


def swapped_axis():
    gyro = flown_logs.flight().gyro
    found = changed({"gyro": np.stack([gyro[:, 1], -gyro[:, 0], gyro[:, 2]], axis=-1)})
    return found, "gyro_body", {"columns": ["-gyro_y", "gyro_x", "gyro_z"]}


def w_first():
    q = flown_logs.flight().q[:, [3, 0, 1, 2]]
    return changed({"quat": q}), "q_world_body", {"columns": ["quat_y", "quat_z", "quat_w", "quat_x"]}


def inverse():
    q = geometry.quaternion_conjugate(flown_logs.flight().q)
    return changed({"quat": q}), "q_world_body", {"columns": ["-quat_x", "-quat_y", "-quat_z", "quat_w"]}


def in_millimetres():
    return changed({"pos": 1000.0 * flown_logs.flight().p}), "p_world", {"unit": "mm"}


def in_kilometres_an_hour():
    return changed({"vel": 3.6 * flown_logs.flight().v}), "v_world", {"unit": "km/h"}


def north_east_down():
    return changed({"vel": flown_logs.ned(flown_logs.flight().v)}), "v_world", {"world": "NED"}


def in_the_body():
    flown = flown_logs.flight()
    return changed({"vel": geometry.rotate_inverse(flown.q, flown.v)}), "v_world", {"body": "FLU"}


MISTAKES = (in_degrees, in_g, pointing_down, gyro_frd, swapped_axis, w_first, inverse)
MISTAKES += (in_millimetres, in_kilometres_an_hour, north_east_down, in_the_body)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named_and_its_cure_gives_the_flight(tmp_path, mistake):
    columns, channel, cure = mistake()
    path = tmp_path / "flight.csv"
    path.write_bytes(flown_logs.csv(columns))
    with pytest.raises(UsageError) as error:
        flight_files.read(path)
    text = str(error.value)
    advice = yaml.safe_load("{" + text.split(f"give {channel} `")[1].rstrip("`") + "}")
    assert advice == cure
    names = [column.removeprefix("-") for column in cure.get("columns", ())]
    assert all(name in text for name in names) and "flight.csv" in text

    log, mapping = reading.open_log(path, None)
    corrected = mapping.with_channel(channel, **{key: tuple(v) if key == "columns" else v for key, v in cure.items()})
    mapping_file.write(corrected, tmp_path / "mapping.yaml")
    table = flight_files.read(path, tmp_path / "mapping.yaml")
    assert not table.contradicted
    truth = {"gyro_body": "gyro", "specific_force_body": "force", "p_world": "p", "v_world": "v", "q_world_body": "q"}
    np.testing.assert_allclose(table[channel].values, getattr(flown_logs.flight(), truth[channel]), atol=1e-8)


@pytest.mark.parametrize(("unit", "per_second"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_times_in_another_unit_are_named(tmp_path, unit, per_second):
    columns = flown_logs.columns()
    columns["timestamp"] = columns["timestamp"] * per_second
    path = tmp_path / "flight.csv"
    path.write_bytes(flown_logs.csv(columns))
    with pytest.raises(UsageError, match=f"column timestamp is in {unit}: give `time: .*unit: {unit}"):
        flight_files.read(path)


@pytest.mark.parametrize(("name", "per_second"), [("time_ms", 1e3), ("Timestamp [ns]", 1e9), ("t (us)", 1e6)])
def test_units_in_the_names_of_columns_are_used(tmp_path, name, per_second):
    columns = flown_logs.columns()
    columns = {name: columns.pop("timestamp") * per_second} | columns
    columns = {column.replace("gyro_", "gyro "): values for column, values in columns.items()}
    columns |= {f"gyro {axis}": np.degrees(columns[f"gyro {axis}"]) for axis in AXES}
    columns = {f"{c} (deg/s)" if c.startswith("gyro") else c: values for c, values in columns.items()}
    path = tmp_path / "flight.csv"
    path.write_bytes(flown_logs.csv(columns))
    table = flight_files.read(path)
    np.testing.assert_allclose(table["gyro_body"].values, flown_logs.flight().gyro, atol=1e-8)
    np.testing.assert_allclose(table["gyro_body"].t, flown_logs.flight().t, atol=1e-6)


def test_two_unrelated_signals_are_reported_and_not_explained(tmp_path):
    rng = np.random.default_rng(1)
    path = tmp_path / "flight.csv"
    smooth = np.cumsum(rng.standard_normal((len(flown_logs.flight().t), 3)), axis=0) / 20.0
    path.write_bytes(flown_logs.csv(changed({"gyro": smooth})))
    table = flight_files.read(path)
    assert table.contradicted
    (note,) = [note for note in table.notes if "DOES NOT HOLD" in note]
    assert "gyro" in note and "no other unit, frame or order of columns explains it" in note


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("channels: {gyro: {columns: [a, b, c]}}", "must be one of p_world"),
        ("channels: {gyro_body: {columns: [a, b]}}", "gyro_body needs 3 columns, not 2"),
        ("channels: {gyro_body: {columns: [a, b, c], unit: deg}}", "'gyro_body, unit' must be one of rad/s, deg/s"),
        ("channels: {gyro_body: {columns: [a, b, c], world: NED}}", "gyro_body has no 'world'"),
        ("channels: {gyro_body: {columns: [a, b, c], body: XYZ}}", "'body' must be one of , FLU, FRD, RFU"),
        ("channels: {motor_command: {columns: [a], range: [1, 1]}}", "two different values"),
        ("channels: {v_world: {columns: [a, b, c], world: NED, body: FLU}}", "either 'world' or 'body'"),
        ("time: {column: t, unit: h}\nchannels: {}", "'unit' must be one of s, ms, us, ns"),
        ("channels: {voltage: {columns: [v], factor: 2}}", "unknown key 'factor'"),
    ],
)
def test_a_wrong_mapping_file_is_refused_in_one_sentence(tmp_path, text, sentence):
    path = tmp_path / "mapping.yaml"
    path.write_text(text)
    with pytest.raises(UsageError) as error:
        mapping_file.read(path)
    assert sentence in str(error.value)


def test_a_column_that_the_log_lacks_is_named_with_the_nearest_one(tmp_path):
    path, mapping = tmp_path / "flight.csv", tmp_path / "mapping.yaml"
    path.write_bytes(flown_logs.csv(flown_logs.columns()))
    mapping.write_text("time: {column: timestamp}\nchannels: {gyro_body: {columns: [gyro_x, gyro_y, gyr_z]}}")
    with pytest.raises(UsageError, match="flight.csv lacks the column 'gyr_z'; the nearest name is 'gyro_z'"):
        flight_files.read(path, mapping)
