"""Gap reports and trainings are saved for the Rerun viewer and read back; what is nothing of these is refused."""

import json

import cv2
import numpy as np
import pytest
from report_example import REPORT

from swift_ros import cli
from swift_sim_bridge.gap.report import residual_file
from swift_sim_bridge.gap.report.residual_file import ResidualCurves
from swift_sim_bridge.view import sources

T = 0.02 * np.arange(100)
BEFORE = np.stack([np.sin(T), 3.0 * np.cos(T)], axis=1)


def curves(name="flight") -> ResidualCurves:
    return ResidualCurves(
        name=name,
        t=T,
        p_world=np.stack([T, 2 * T, 0 * T + 1.0], axis=1),
        channels=np.array(["specific force x", "rotor 1 speed"]),
        units=np.array(["m/s^2", "rad/s"]),
        layers=np.array(["force", "motor"]),
        noise=np.array([0.1, 0.3]),
        before=BEFORE,
        after=0.1 * BEFORE,
    )


@pytest.fixture
def report(tmp_path):
    """Return a folder with a gap report."""
    folder = tmp_path / "report"
    folder.mkdir()
    (folder / "report.json").write_text(json.dumps(REPORT))
    residual_file.write(folder / "residuals.npz", [curves()])
    cv2.imwrite(str(folder / "time.png"), np.full((20, 30, 3), 90, np.uint8))
    return folder


def saved(path, out):
    pytest.importorskip("rerun", reason="needs Rerun: make view")
    from rerun_file import RerunFile

    assert cli.main(["view", str(path), "--save", str(out)]) == 0
    return RerunFile(out)


def test_residuals_survive_their_file(report):
    (read,) = residual_file.read(report / "residuals.npz")
    for name in residual_file.ARRAYS:
        assert np.array_equal(getattr(read, name), getattr(curves(), name)), name
    assert read.mismatch(read.before)[0] == pytest.approx(3.0 / 0.3)


def test_the_residuals_of_a_gap_report_are_curves_before_and_after_the_repair(report, tmp_path):
    shown = saved(report, tmp_path / "gap.rrd")
    for side, share in (("before", 1.0), ("after", 0.1)):
        for entity, column in (("force/specific_force_x", 0), ("motor/rotor_1_speed", 1)):
            t, values = shown.curve(f"residuals/flight/{entity}/{side}")
            assert t == pytest.approx(T, abs=1e-8)
            assert values[:, 0] == pytest.approx(share * BEFORE[:, column])
    (text,) = shown.texts("about")
    assert "rotor_drag: ambiguous" in text and "k_d = 6e-05" in text
    assert "pictures/time" in shown.entities and "map/flight" in shown.entities and shown.has_blueprint


def test_a_report_without_residuals_is_shown_and_says_what_is_missing(report, tmp_path):
    (report / "residuals.npz").unlink()
    (text,) = saved(report, tmp_path / "gap.rrd").texts("about")
    assert "no residuals.npz" in text


@pytest.mark.parametrize(("log", "timeline"), [("progress.jsonl", "interactions"), ("log.jsonl", "step")])
def test_the_log_of_a_training_is_curves_over_its_progress(tmp_path, log, timeline):
    rows = [
        {timeline: 100 * i, "loss": 1.0 / (1 + i), "laps": [5.0, 6.0 + i], "best": None, "done": i > 3}
        for i in range(6)
    ]
    lines = [json.dumps(row) for row in rows]
    (tmp_path / log).write_text("\n".join([*lines, lines[0][:9]]))  # a training is writing the last line
    cv2.imwrite(str(tmp_path / "progress.png"), np.full((20, 30, 3), 90, np.uint8))
    shown = saved(tmp_path, tmp_path / "training.rrd")
    for name, values in (("loss", [1.0 / (1 + i) for i in range(6)]), ("laps_2", [6.0 + i for i in range(6)])):
        steps, found = shown.curve(f"training/{name}", timeline)
        assert steps.tolist() == [100 * i for i in range(6)] and found[:, 0] == pytest.approx(values)
    assert "pictures/progress" in shown.entities
    assert not {"training/best", f"training/{timeline}"} & shown.entities


def test_each_folder_is_recognised(report, tmp_path):
    assert sources.recognise(report) == (sources.GAP, report)
    (tmp_path / "log.jsonl").write_text("{}")
    assert sources.recognise(tmp_path) == (sources.TRAINING, tmp_path)
    bag = tmp_path / "race" / "seed-0" / "bag"
    bag.mkdir(parents=True)
    (bag / "bag_0.mcap").write_bytes(b"")
    assert sources.recognise(tmp_path / "race") == (sources.BAG, bag)


def test_what_cannot_be_shown_is_refused_in_a_sentence(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for name in ("a", "b"):
        (tmp_path / "two" / name).mkdir(parents=True)
        (tmp_path / "two" / name / "bag_0.mcap").write_bytes(b"")
    (tmp_path / "empty").mkdir()
    for arguments, sentence in (
        ([str(tmp_path / "none")], "none does not exist; give a bag"),
        ([str(tmp_path / "file")], "file is no .mcap file"),
        ([str(tmp_path / "empty")], "empty holds neither a bag nor report.json"),
        ([str(tmp_path / "two")], "holds 2 bags; choose one"),
        ([str(tmp_path / "two" / "a"), "--save", "view.mp4"], "does not end with .rrd"),
        (["--seconds", "0"], "--seconds 0 is not above 0"),
        (["--foxglove", str(tmp_path / "file" / "layout.json")], "cannot be written"),
    ):
        assert cli.main(["view", *arguments]) == 2
        error = capsys.readouterr().err
        assert sentence in error and len(error.strip().splitlines()) == 1


def test_damaged_files_are_refused_in_a_sentence(report, tmp_path, capsys):
    pytest.importorskip("rerun", reason="needs Rerun: make view")
    out = str(tmp_path / "view.rrd")
    (report / "residuals.npz").write_bytes(b"PK no archive")
    (tmp_path / "training").mkdir()
    (tmp_path / "training" / "log.jsonl").write_text('{"step": 1}\nno JSON\n{"step": 2}\n')
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.mcap").write_bytes(b"no MCAP")
    for path, sentence in (
        (report, "residuals.npz cannot be read"),
        (tmp_path / "training", "log.jsonl, line 2 is no JSON"),
        (tmp_path / "bag", "bag_0.mcap"),
    ):
        assert cli.main(["view", str(path), "--save", out]) == 2
        error = capsys.readouterr().err
        assert sentence in error and len(error.strip().splitlines()) == 1
    (report / "report.json").write_text("[]")
    assert cli.main(["view", str(report), "--save", out]) == 2
    assert "cannot be read as a gap report" in capsys.readouterr().err


def test_without_rerun_the_command_says_how_to_install_it(report, monkeypatch, capsys):
    import importlib.util

    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "rerun" else find(name))
    assert cli.main(["view", str(report)]) == 2
    error = capsys.readouterr().err
    assert "`make view` installs it" in error and len(error.strip().splitlines()) == 1


def test_without_a_display_the_command_names_the_other_ways(report, monkeypatch, capsys):
    pytest.importorskip("rerun", reason="needs Rerun: make view")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert cli.main(["view", str(report)]) == 2
    assert "use --web, or --save FILE.rrd" in capsys.readouterr().err
