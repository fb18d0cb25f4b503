"""Texts that are no configuration have one sentence, which names the place and the cure."""

import pytest
import yaml
from changed_files import CONFIG, LEVEL, changed, gates

from swift_ros import cli, configuration
from swift_ros.errors import UsageError
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle


@pytest.mark.parametrize("key", ["terms", "sensors"])
def test_a_key_with_nothing_below_it_has_no_entries(tmp_path, key):
    content = yaml.safe_load((CONFIG / "drone.yaml").read_text()) | {key: None}
    path = tmp_path / "drone.yaml"
    path.write_text(yaml.safe_dump(content))
    assert f"{key}: null" in path.read_text()
    assert getattr(configuration.load(Vehicle, path), key) == {}


@pytest.mark.parametrize("name", ["nodes.yaml", "simulation.yaml", "training.yaml"])
def test_a_file_of_each_kind_is_recognised_by_its_content(tmp_path, name):
    path = tmp_path / f"my_{name}"
    text = (CONFIG / name).read_text()
    path.write_text(text)
    assert cli.main(["check", str(path)]) == 0
    path.write_text(text + "another_section: {}\n")
    assert cli.main(["check", str(path)]) == 1


def test_a_misspelt_section_and_a_torn_file_have_one_sentence_each(folder, capsys):
    text = (folder / "nodes.yaml").read_text()
    (folder / "nodes.yaml").write_text(text.replace("\nbetaflight:", "\nbetaflght:"))
    (folder / "training.yaml").write_text("policy: [")
    assert cli.main(["check", str(folder)]) == 1
    first, second = capsys.readouterr().out.splitlines()
    assert "has the unknown section 'betaflght'; did you mean 'betaflight'?" in first
    assert "training.yaml: impossible: is not valid YAML" in second


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            "  - {position: [9.2, 6.6",
            "\t- {position: [9.2, 6.6",
            "is indented by a tab, where YAML needs spaces, at line 13",
        ),
        ("yaw_deg: 70.0", "yaw_deg: .nan", "has '.nan', which is no finite number, at line 17"),
        ("depth: 0.1", "depth: .inf", "has '.inf', which is no finite number, at line 5"),
        ("depth: 0.1", "depth: 0,1", "key 'depth' must be a finite number, not '0,1'; write 0.1"),
        ("[-1.1, -1.6, 3.6]", "[-1,1, -1,6, 3,08]", "must have 3 entries, not 6; decimal commas. write 0.06"),
        ("inner_side: 1.5", "iner_side: 1.5", "has the unknown key 'iner_side'; did you mean 'inner_side'"),
        ("depth: 0.1", "<<<<<<< HEAD\ndepth: 0.1", "has the mark '<<<<<<<' of an unresolved merge at line 5"),
        ("depth: 0.1", "depth: 0.1\n>>>>>>> hall", "has the mark '>>>>>>>' of an unresolved merge at line 6"),
        ("laps: 3", "laps: yes", "key 'laps' must be a whole number, not true"),
        (
            "name: Split-S",
            "name: &name [Split-S, *name]",
            "has the alias '.name' within the part that it names at line 2",
        ),
        ("name: Split-S", "name: Split-\u00df", "is not UTF-8 text at line 2; save it as UTF-8"),
        ("laps: 3", "laps:", "key 'laps' must be a whole number, not null"),
        ("laps: 3", "laps: 2024-05-01", "key 'laps' must be a whole number, not 2024-05-01"),
        ("laps: 3", "laps: [yes, {a: ~}]", r"key 'laps' must be a whole number, not \[true, \{'a': null\}\]"),
        ("laps: 3", "laps: 3\ndepth: 0.2", "has the key 'depth' twice, at line 5 and at line "),
        ("gates:", "---\ngates:", "begins a second document at line 11"),
    ],
)
def test_what_is_wrong_in_a_text_is_said_with_its_line(tmp_path, old, new, sentence):
    path = tmp_path / "track.yaml"
    text = (CONFIG / "track.yaml").read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new), encoding="latin-1" if "\u00df" in new else "utf-8")
    with pytest.raises(UsageError, match=sentence):
        configuration.load(Track, path)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "is empty; write its keys"),
        ("# only a comment\n", "is empty; write its keys"),
        ("gate,x,y\n1,2,3\n", "mapping of keys to values, not 'gate,x,y 1,2,3'"),
    ],
)
def test_a_file_without_keys_is_said(folder, capsys, text, sentence):
    (folder / "simulation.yaml").write_text(text)
    assert cli.main(["check", str(folder)]) == 1
    [line] = capsys.readouterr().out.splitlines()
    assert "simulation.yaml: impossible: " in line and sentence in line


def test_the_entries_of_a_list_are_counted_from_one(tmp_path):
    path = changed(tmp_path, "track", {"gates": [*gates(LEVEL), {"position": [0.0, "x", 2.0], "yaw_deg": 0.0}]})
    with pytest.raises(UsageError, match="gate 2, key 'position', entry 2 must be a finite number"):
        configuration.load(Track, path)


def test_what_is_no_configuration_is_bad_input(tmp_path, capsys):
    (tmp_path / "list.yaml").write_text("colour: red\n")
    for path in (tmp_path / "list.yaml", tmp_path / "none", tmp_path):
        assert cli.main(["check", str(path)]) == 2
    assert capsys.readouterr().err.count("\n") == 3
