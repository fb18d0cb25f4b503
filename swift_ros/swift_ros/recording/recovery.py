"""Writes the readable rest of a damaged bag as a sound bag."""

from dataclasses import dataclass, replace
from pathlib import Path

from swift_ros.errors import UsageError
from swift_ros.recording import bags
from swift_ros.recording.bag_writer import BagWriter
from swift_ros.recording.mcap_format.mcap_file import Damage, Topic
from swift_ros.recording.mcap_format.message_definitions import schema_text


@dataclass(frozen=True)
class Recovered:
    """What a recovered bag holds and what it lacks.

    Attributes:
        counts: number of messages by topic.
        damage: parts of the damaged bag that could not be read.
    """

    counts: dict[str, int]
    damage: list[Damage]


def recover(bag: Path, out: Path) -> Recovered:
    """Write all readable messages of a bag to a new bag of one file.

    Args:
        bag: bag folder or .mcap file.
        out: folder of the new bag.

    Raises:
        UsageError: there is no readable topic in the bag, or `out` cannot be written or holds a bag.
    """
    files = bags.open_files(bag)
    topics = {topic.name: topic for file in files for topic in file.topics.values()}
    if not topics:
        raise UsageError(f"{bag} holds no readable topic; nothing of it can be recovered")
    writer = BagWriter(out, next((file.custom for file in files if file.custom), None))
    counts, damage = dict.fromkeys(sorted(topics), 0), []
    try:
        for topic in topics.values():
            writer.add_recorded_topic(_with_definition(topic))
        for part in (part for file in files for part in file.contents()):
            if isinstance(part, Damage):
                damage.append(part)
            else:
                writer.write(part.topic, part.data, part.log_time_ns, part.publish_time_ns)
                counts[part.topic] += 1
    finally:
        writer.close()
    return Recovered(counts, damage)


def _with_definition(topic: Topic) -> Topic:
    """Return a topic with the installed definition of its type where the bag's own is lost."""
    if topic.definition:
        return topic
    try:
        return replace(topic, definition=schema_text(topic.type).encode())
    except UsageError:  # a type that is not installed here: readers that know it need no definition
        return topic
