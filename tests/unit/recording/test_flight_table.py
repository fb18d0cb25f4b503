"""Flight tables in files: measurements are read unchanged, invalid samples are reported, missing data is refused."""

import sys

import numpy as np
import pytest

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.recording import flight_files
from swift_ros.recording.flight_channels import CHANNELS, known_columns

RATE = 200.0
N = 400


def flight(n=N, rate=RATE):
    """Return the columns of a flight of two seconds with four rotors."""
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


def test_a_written_table_is_read_back_for_any_order_of_columns(tmp_path):
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
    text = write_csv(tmp_path / "flight.csv", columns).read_text().replace("nan", "")  # an empty field is NaN too
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


def test_invalid_samples_are_reported_and_removed(tmp_path):
    columns = flight()
    columns["ax"][100:140] = columns["ax"][100] + 0.01 * np.arange(40)
    columns["ay"][100:140] = columns["az"][100:140] = 9.81
    columns["u_2"][200] = 4.8
    columns["qw"][300] = 0.0
    columns["t"][350] = columns["t"][349]
    table = flight_files.read(write_csv(tmp_path / "flight.csv", columns))
    rejected = {rejection.channel: rejection for rejection in table.rejections}
    assert set(rejected) == {"specific_force_body", "motor_command", "q_world_body", "t"}
    assert (rejected["specific_force_body"].begin_s, rejected["specific_force_body"].end_s) == pytest.approx(
        (0.5, 0.695)
    )
    assert "4.8" in rejected["motor_command"].reason and "length" in rejected["q_world_body"].reason
    assert len(table["specific_force_body"].t) == N - 41 and len(table["p_world"].t) == N - 1


@pytest.mark.parametrize(("row", "time"), [(0, 0.0), (200, 9e12), (0, np.nan), (300, -1.7e6)])
def test_a_time_of_another_clock_is_reported_and_removed(tmp_path, row, time):
    columns = flight()
    columns["t"] += 1.7e6
    columns["t"][row] = time
    table = flight_files.read(write_csv(tmp_path / "flight.csv", columns))
    (rejected,) = (rejection for rejection in table.rejections if "no data for" not in rejection.reason)
    assert rejected.channel == "t" and rejected.begin_s == rejected.end_s == (1.7e6 + 0.005 if np.isnan(time) else time)
    assert len(table["p_world"].t) == N - 1 and table.span_s[1] - table.span_s[0] < 3.0


def test_decreasing_times_are_reported_with_their_span(tmp_path):
    columns = flight()
    columns["t"][200:210] -= 0.5
    (rejected,) = (
        rejection
        for rejection in flight_files.read(write_csv(tmp_path / "flight.csv", columns)).rejections
        if "do not increase" in rejection.reason
    )
    assert (rejected.begin_s, rejected.end_s) == pytest.approx((0.5, 0.545))


def test_a_clipped_gyro_is_rejected_and_other_peaks_are_not(tmp_path):
    columns = flight(n=2000)
    columns["wx"] = 20.0 * np.sin(3.0 * columns["t"]) + 0.05 * np.random.default_rng(1).standard_normal(2000)
    for unclipped in (columns["wx"], np.round(columns["wx"] / 0.05) * 0.05, np.repeat(columns["wx"][::5], 5)):
        table = flight_files.read(write_csv(tmp_path / "complete.csv", columns | {"wx": unclipped}))
        assert not table.rejections
    clipped = np.clip(np.round(columns["wx"] / 0.001) * 0.001, -17.453, 17.453)
    table = flight_files.read(write_csv(tmp_path / "clipped.csv", columns | {"wx": clipped}))
    assert {rejection.channel for rejection in table.rejections} == {"gyro_body"} and len(table.rejections) >= 10
    assert all("largest or smallest value: clipped" in rejection.reason for rejection in table.rejections)
    assert np.abs(table["gyro_body"].values[:, 0]).max() < 17.453


def test_a_constant_pose_is_frozen_while_the_gyro_turns_and_valid_at_rest(tmp_path):
    columns = flight(n=1000)
    pose = [name for name in columns if name in ("px", "py", "pz", "vx", "vy", "vz", "qx", "qy", "qz", "qw")]
    held = {name: np.where(np.arange(1000) // 100 == 5, columns[name][500], columns[name]) for name in pose}
    table = flight_files.read(write_csv(tmp_path / "frozen.csv", columns | held))
    rejected = {rejection.channel: rejection for rejection in table.rejections}
    assert set(rejected) == {"p_world", "q_world_body", "v_world"}
    assert all((rejection.begin_s, rejection.end_s) == pytest.approx((2.505, 2.995)) for rejection in rejected.values())
    assert all(rejection.reason == "constant while the gyro turns: frozen" for rejection in rejected.values())
    rest = {name: np.full(1000, columns[name][500]) for name in pose}
    noise = np.random.default_rng(2).standard_normal((3, 1000))
    rest |= {f"w{axis}": 0.1 + 0.2 * noise[i] for i, axis in enumerate("xyz")}
    assert not flight_files.read(write_csv(tmp_path / "rest.csv", columns | rest)).rejections


def test_a_constant_rotor_speed_is_frozen_while_its_command_changes_and_valid_at_idle(tmp_path):
    columns = flight(n=1000)
    columns["u_2"] = 0.5 + 0.3 * np.sin(5.0 * columns["t"])
    held = np.where(np.arange(1000) // 100 == 5, columns["rotor_2"][500], columns["rotor_2"])
    (rejected,) = flight_files.read(write_csv(tmp_path / "frozen.csv", columns | {"rotor_2": held})).rejections
    assert (rejected.begin_s, rejected.end_s) == pytest.approx((2.505, 2.995)) and rejected.channel == "rotor_speed"
    assert rejected.reason == "constant while the commands change: frozen"
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
            "no valid rows of px, py, pz: 399 times do not increase",
        ),
        (scaled("vbat", 1000.0), "vbat are outside of 0.001 to 120 V in 100%"),
        (scaled("vbat", 1000.0), "a flight table is in SI units; are they in millivolts?"),
        (scaled("ibat", 1000.0), "a flight table is in SI units; are they in milliamperes?"),
        (scaled("u_3", 100.0), "outside of -1e-06 to 1 in 100% of the rows"),
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
def test_an_incomplete_flight_is_refused_in_one_sentence(tmp_path, change, sentence):
    columns = flight()
    change(columns)
    with pytest.raises(UsageError) as error:
        flight_files.read(write_csv(tmp_path / "flight.csv", columns))
    assert sentence in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("t,px\n0,1\n1,oops\n", "line 3 has 'oops' in column px, which is not a number, and fewer than two rows"),
        ("t,px\n0,1\n1\n", "line 3 has 1 cells, the header 2, and fewer than two rows"),
        ("t,t\n0,1\n1,2\n", "two columns named 't'"),
        ("t,px\n", "fewer than two rows"),
        ("t;px\n0;1\n1;2\n", "separates its columns by ';'; write ','"),
        ("t,px,\n0,1,\n1,2,\n", "no name for column 3 of 3"),
        ("t,caf\udce9\n0,1\n1,2\n2,3\n", "cannot be read as text"),
    ],
)
def test_an_invalid_file_is_reported_with_its_line(tmp_path, text, sentence):
    (tmp_path / "flight.csv").write_text(text, errors="surrogateescape")
    with pytest.raises(UsageError, match=sentence):
        flight_files.read(tmp_path / "flight.csv")


@pytest.mark.parametrize("missing", [False, True], ids=["complete", "with an empty field"])
def test_a_table_written_by_a_spreadsheet_is_read(tmp_path, missing):
    path = write_csv(tmp_path / "flight.csv", flight())
    first, *rows = path.read_text().splitlines()
    rows[5] = rows[5][: rows[5].rindex(",") + 1] if missing else rows[5]
    path.write_text("\n".join([first, *rows, ""]), encoding="utf-8-sig", newline="\r\n")
    assert len(flight_files.read(path)["p_world"].t) == N - missing * (first.split(",")[-1] == "pz")


def test_a_file_of_another_kind_is_refused(tmp_path):
    (tmp_path / "flight.txt").write_text("hello")
    with pytest.raises(UsageError, match=r"neither .csv, .parquet, a bag \(.mcap, .db3, .bag\) nor a log"):
        flight_files.read(tmp_path / "flight.txt")
    (tmp_path / "flight.bbl").write_bytes(b"")
    with pytest.raises(UsageError, match="convert it to bags with `swiftros import .*flight.bbl`"):
        flight_files.read(tmp_path / "flight.bbl")
    with pytest.raises(UsageError, match="does not exist"):
        flight_files.read(tmp_path / "nowhere.csv")


def test_samples_of_a_meter_are_removed_until_it_is_ready(tmp_path):
    columns = flight()
    columns["vbat"][:5] = 0.0
    table = flight_files.read(write_csv(tmp_path / "flight.csv", columns))
    (rejected,) = table.rejections
    assert rejected.channel == "voltage" and rejected.end_s == pytest.approx(4 / RATE)
    assert table["voltage"].t[0] == pytest.approx(5 / RATE)


def test_parquet_is_read_back_and_a_missing_library_is_named(tmp_path, monkeypatch):
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
