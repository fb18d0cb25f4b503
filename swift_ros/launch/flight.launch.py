"""Starts the onboard nodes of the graph's table (`swift_ros/graph/topic_table.py`).

ros2 launch swift_ros flight.launch.py [config:=DIR] [namespace:=swift] [nodes:=vio,policy] [lockstep:=false]
    [discovery:=local]
"""

import json

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from swift_ros.graph.discovery import choose
from swift_ros.graph.domain import mark_domain
from swift_ros.graph.runner import RESTART_AFTER_S, RESTARTS, launch_rows
from swift_ros.graph.topic_table import NODES, VEHICLE_NAMESPACE

ONBOARD = ",".join(name for name, row in NODES.items() if row.onboard)
ARGUMENTS = (
    ("config", "", "configuration folder; empty: $SWIFT_CONFIG, else the installed folder"),
    ("namespace", VEHICLE_NAMESPACE, "the vehicle's namespace"),
    ("nodes", ONBOARD, "names of the nodes to start"),
    ("lockstep", "false", "run on simulated time, from the simulator's /clock"),
    ("discovery", "local", "who can reach the graph: local (this machine) or subnet"),
    ("parameters", "{}", 'more ROS parameters as JSON: {"node": {"name": value}, "*": {...}}'),
)


def start_nodes(context):
    """Return the nodes to start."""
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    parameters = json.loads(given["parameters"])
    parameters["*"] = {"config": given["config"]} | parameters.get("*", {})
    choose(given["discovery"], context.environment)
    mark_domain(int(context.environment.get("ROS_DOMAIN_ID") or 0))
    names = [name for name in given["nodes"].split(",") if name]
    lockstep = given["lockstep"].lower() == "true"
    rows = launch_rows(names, parameters, lockstep=lockstep, namespace=given["namespace"])
    # a flight goes on without some nodes, which are started again
    return [
        Node(
            **launch,
            output="both",
            respawn=not NODES[name].needed,
            respawn_delay=RESTART_AFTER_S,
            respawn_max_retries=RESTARTS,
        )
        for name, launch in rows.items()
    ]


def generate_launch_description():
    """Return the launch arguments and the nodes."""
    declared = [DeclareLaunchArgument(name, default_value=value, description=text) for name, value, text in ARGUMENTS]
    return LaunchDescription([*declared, OpaqueFunction(function=start_nodes)])
