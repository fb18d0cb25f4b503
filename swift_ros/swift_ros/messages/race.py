"""The race: its status, and the gates of its track as markers."""

from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from swift_msgs.msg import RaceStatus
from swift_ros.messages.stamps import from_time, to_time
from swift_ros.messages.vectors import to_pose
from swift_ros.race.judge import RaceEvent
from swift_ros.track import Track


def to_race_status(event: RaceEvent) -> RaceStatus:
    """Return swift_msgs/RaceStatus."""
    message = RaceStatus(state=event.state, next_gate=int(event.next_gate), lap=int(event.lap), text=event.text)
    message.header.stamp = to_time(event.stamp_ns)
    message.header.frame_id = "map"
    message.split_s, message.margin_m = float(event.split_s), float(event.margin_m)
    return message


def from_race_status(message: RaceStatus) -> RaceEvent:
    """Return the race event of a message."""
    stamp = from_time(message.header.stamp)
    numbers = message.next_gate, message.lap, message.split_s, message.margin_m
    return RaceEvent(stamp, message.state, *numbers, message.text)


def to_track_markers(track: Track) -> MarkerArray:
    """Return markers of the gates in the map: frames, numbers and directions of passage."""
    markers = []
    for i in range(len(track.gates)):
        base = {"ns": f"gate {i + 1}", "action": Marker.ADD}
        pose = to_pose(track.positions[i], track.attitudes[i])
        frame = Marker(**base, id=0, type=Marker.LINE_STRIP, pose=to_pose((0, 0, 0), (0, 0, 0, 1)))
        frame.points = [Point(x=x, y=y, z=z) for x, y, z in track.corners[i][[0, 1, 2, 3, 0]]]
        frame.scale.x, frame.color = 0.1, ColorRGBA(r=0.9, g=0.3, b=0.1, a=1.0)
        arrow = Marker(**base, id=1, type=Marker.ARROW, pose=pose, color=ColorRGBA(r=0.2, g=0.6, b=0.2, a=1.0))
        arrow.scale = Vector3(x=0.6, y=0.06, z=0.06)
        number = Marker(**base, id=2, type=Marker.TEXT_VIEW_FACING, pose=pose, text=str(i + 1))
        number.pose.position.z += 0.5 * float(track.outer_sides[i])
        number.scale.z, number.color = 0.5, ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
        markers += [frame, arrow, number]
    for marker in markers:
        marker.header.frame_id = "map"
    return MarkerArray(markers=markers)
