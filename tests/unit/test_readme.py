"""The README tells what is: its tables are those of the code, its commands exist, its files are there."""

import re
import subprocess
import sys

import pytest

from swift_ros.graph.topic_table import IMPORTED, NODES, TOPICS


@pytest.fixture
def readme(repository):
    return (repository / "README.md").read_text()


def topic_table() -> str:
    """Return the topics of the graph as the README shows them."""
    speakers = {topic: [node.name for node in NODES.values() if topic in node.publishes] for topic in TOPICS}
    rows = ["| topic | type | Hz | from | meaning |", "|---|---|---|---|---|"]
    for topic in TOPICS.values():
        rate = f"{topic.rate_hz:g}" if topic.rate_hz else "events"
        speaker = ", ".join(speakers[topic.name]) or ("import" if topic.name in IMPORTED else "every node")
        rows.append(f"| `{topic.name}` | {topic.type.replace('/msg/', '/')} | {rate} | {speaker} | {topic.meaning} |")
    return "\n".join(rows)


def test_the_topics_are_those_of_the_graph(readme):
    shown = readme.split("held equal by a test -->\n")[1].split("\n<!-- end of topics")[0]
    assert shown == topic_table()


def test_its_commands_are_known(readme):
    second = "list|hz|echo|latency|policy|detector|gap|vehicle|firmware"
    told = set(re.findall(rf"(?m)^swiftros ([a-z-]+)(?: ({second})\b)?", readme))
    assert len(told) > 8
    for words in told:
        asked = subprocess.run(
            [sys.executable, "-m", "swift_ros.cli", *filter(None, words), "--help"], capture_output=True, text=True
        )
        assert asked.returncode == 0, asked.stderr


def test_its_pictures_and_folders_exist(readme, repository):
    pictures, folders = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", readme), re.findall(r"(?m)^\| `(\w+/)` \|", readme)
    for path in pictures + folders:
        assert (repository / path).exists(), path
