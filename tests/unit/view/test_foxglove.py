"""The layout for Foxglove names topics of the table, and fields that their messages have."""

import json
import re

import pytest

from swift_ros import cli
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.messages.serialization import message_type
from swift_sim_bridge.view import foxglove

TYPES = {full_name(topic.name): topic.type for topic in TOPICS.values()}


@pytest.fixture
def layout(tmp_path, capsys):
    """Return the layout that the command writes."""
    out = tmp_path / "layout" / "swift.json"
    assert cli.main(["view", "--foxglove", str(out)]) == 0
    assert "Import from file" in capsys.readouterr().out
    return json.loads(out.read_text())


def paths(value):
    """Return all texts below a value that begin with a slash, keys included."""
    if isinstance(value, dict):
        return [text for item in value.items() for one in item for text in paths(one)]
    if isinstance(value, list):
        return [text for one in value for text in paths(one)]
    return [value] if isinstance(value, str) and value.startswith("/") else []


def test_all_topics_and_fields_exist(layout):
    found = paths(layout["configById"])
    assert len(found) > 30
    for one in found:
        topic, *fields = one.split(".")
        assert topic in TYPES, one
        kind = TYPES[topic]
        for field in fields:
            name, index = re.fullmatch(r"(\w+)(\[\d\])?", field).groups()
            known = message_type(kind).get_fields_and_field_types()
            assert name in known, one
            is_array = known[name].startswith("sequence")
            assert is_array == bool(index), one
            kind = known[name].replace("/", "/msg/")


def test_every_panel_has_a_place(layout):
    def places(node):
        return [node] if isinstance(node, str) else places(node["first"]) + places(node["second"])

    assert sorted(places(layout["layout"])) == sorted(layout["configById"])


def test_the_panels_show_what_the_rerun_layout_shows():
    titles = " ".join(foxglove.PLOTS)
    for shown in ("body rate x", "body rate y", "body rate z", "collective thrust", "motor", "rotor speeds", "battery"):
        assert shown in titles
