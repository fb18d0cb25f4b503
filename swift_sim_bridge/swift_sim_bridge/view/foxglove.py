"""The same panels as a layout of Foxglove, which reads the bags as they are. No Rerun, no ROS."""

from swift_ros.graph.topic_table import full_name

AXES = ("x", "y", "z")
# Paths into messages, as Foxglove writes them: name of the topic, then fields. By title of the plot.
PLOTS = {
    **{
        f"body rate {axis}, rad/s": (
            ("command/body_rate_thrust", f"body_rate.{axis}"),
            ("imu/data_raw", f"angular_velocity.{axis}"),
        )
        for axis in AXES
    },
    "collective thrust, m/s²": (("command/body_rate_thrust", "thrust"), ("imu/data_raw", "linear_acceleration.z")),
    "position, m": tuple(
        (topic, f"pose.pose.position.{axis}") for axis in AXES for topic in ("state/odometry", "ground_truth/odometry")
    ),
    "motor commands": tuple(("betaflight/rotors", f"motor[{i}]") for i in range(4)),
    "rotor speeds, rad/s": tuple(("betaflight/rotors", f"speed[{i}]") for i in range(4)),
    "battery": (("battery", "voltage"), ("battery", "current")),
    "MSP round trip, ms": (("betaflight/link", "round_trip_ms"),),
}
COLORS = ("#ffa028", "#50aaff", "#5adc6e", "#e65ac8", "#ebebeb", "#f05050")
IN_SPACE = ("track/markers", "state/odometry", "ground_truth/odometry")
STATES = (("race/status", "state"), ("race/status", "next_gate"), ("betaflight/link", "armed"))
IMAGE, TEXTS, HEALTH = "camera/image_raw", "race/status", "/diagnostics"
HOW_TO_OPEN = (
    "In Foxglove: 'Open local file' and choose the bag's .mcap file, then 'Layouts', 'Import from file' and choose "
    "this layout."
)


def layout() -> dict:
    """Return the layout, as Foxglove exports it: map left, image right, curves below."""
    panels = {
        "3D!map": {
            "followTf": "map",
            "fixedFrame": "map",
            "topics": {full_name(topic): {"visible": True} for topic in IN_SPACE},
        },
        "Image!camera": {"imageMode": {"imageTopic": full_name(IMAGE)}},
        "RawMessages!race": {"topicPath": full_name(TEXTS)},
        "DiagnosticSummary!health": {"topicToRender": full_name(HEALTH), "minLevel": 0},
        "StateTransitions!race": {
            "isSynced": True,
            "paths": [{"value": path(*state), "timestampMethod": "headerStamp"} for state in STATES],
        },
    }
    plots = {f"Plot!{i}": plot(title) for i, title in enumerate(PLOTS)}
    names = [*plots, "StateTransitions!race"]
    right = split("column", "Image!camera", split("column", "RawMessages!race", "DiagnosticSummary!health", 50), 60)
    rows = [row(names[i : i + 4]) for i in range(0, len(names), 4)]
    below = rows[-1]
    for one in reversed(rows[:-1]):
        below = split("column", one, below, 50)
    return {
        "configById": panels | plots,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1.0},
        "layout": split("column", split("row", "3D!map", right, 62), below, 55),
    }


def plot(title: str) -> dict:
    """Return the panel of a plot."""
    curves = [
        {"value": path(*curve), "enabled": True, "timestampMethod": "headerStamp", "color": COLORS[i % len(COLORS)]}
        for i, curve in enumerate(PLOTS[title])
    ]
    return {"foxglovePanelTitle": title, "paths": curves, "showLegend": True, "isSynced": True, "xAxisVal": "timestamp"}


def path(topic: str, field: str) -> str:
    """Return the path of a field of a topic, by the topic's name in the table."""
    return f"{full_name(topic)}.{field}"


def row(names: list[str]):
    """Return panels side by side, all of one width."""
    if len(names) == 1:
        return names[0]
    return split("row", names[0], row(names[1:]), round(100 / len(names)))


def split(direction: str, first, second, percentage: int) -> dict:
    """Return two panels or splits side by side ("row") or one below the other ("column")."""
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}
