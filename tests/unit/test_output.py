"""The reader of a command's output leaves: the work is finished, and the exit code is the command's own."""

import contextlib
import os
import subprocess
import sys

import numpy as np
import pytest

from swift_ros import cli
from swift_ros.commands import output
from swift_ros.recording import flight_files

T = np.arange(0.0, 8.0, 0.01)
NAMES = "time_ms,gyro_x (deg/s),gyro_y (deg/s),gyro_z (deg/s),acc_x (g),acc_y (g),acc_z (g)," + ",".join(
    f"motor_{i}" for i in (1, 2, 3, 4)
)


@pytest.fixture
def log(tmp_path):
    """Write a table of another program: a hover of 8 s with a swinging roll."""
    zero, one = 0.0 * T, 1.0 + 0.0 * T
    columns = [1e3 * T, 40.0 * np.sin(T), zero, zero, 0.0 * T, zero, one, *(0.4 * one,) * 4]
    path = tmp_path / "flight.csv"
    np.savetxt(path, np.column_stack(columns), "%.6g", ",", header=NAMES, comments="")
    return path


def run_without_reader(*arguments) -> subprocess.CompletedProcess:
    """Run swiftros with a standard output that nobody reads."""
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "swift_ros.cli", *arguments]
    try:
        return subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, timeout=120)
    finally:
        os.close(writer)


def test_a_table_is_converted_although_nobody_reads_what_is_printed(log, tmp_path):
    out = tmp_path / "table.csv"
    done = run_without_reader("import", str(log), "--out", str(out))
    assert (done.returncode, done.stderr) == (0, "")
    table = flight_files.read(out)
    assert len(table["gyro_body"].t) == len(T)


def test_the_exit_code_of_a_failure_is_kept(tmp_path):
    done = run_without_reader("import", str(tmp_path / "nothing.csv"))
    assert done.returncode == 2 and "nothing.csv does not exist" in done.stderr


def test_a_help_that_nobody_reads_ends_without_a_traceback():
    done = run_without_reader("--help")
    assert (done.returncode, done.stderr) == (0, "")


@contextlib.contextmanager
def printing_to_a_pipe():
    """Make standard output a pipe and yield its reading end. Not a fixture: pytest redirects the output after those."""
    reader, writer = os.pipe()
    opened = os.fdopen(reader, "rb", buffering=0), os.fdopen(writer, "w")
    with opened[0] as read, opened[1] as stream, contextlib.redirect_stdout(stream):
        yield read


def test_lines_arrive_at_once_until_the_reader_leaves():
    with printing_to_a_pipe() as pipe, output.lasting():
        print("first")
        assert pipe.read(100) == b"first\n" and output.is_read()
        pipe.close()
        print("second")
        assert not output.is_read()
        print("third")  # as every print after it


def test_a_command_gives_back_the_stream_that_it_was_given():
    with printing_to_a_pipe():
        given = sys.stdout
        assert cli.main(["--nonsense"]) == 2
        assert sys.stdout is given


def test_a_full_disk_is_a_sentence(monkeypatch, capsys):
    def run(argv):
        with open("/dev/full", "w") as file:
            file.write("a race")

    monkeypatch.setattr(cli, "run", run)
    assert cli.main(["race"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("swiftros: the disk has no space left") and said.count("\n") == 1
