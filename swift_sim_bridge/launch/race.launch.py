"""Starts a race: `flight.launch.py` without the camera driver, and the simulator in place of the hardware.

ros2 launch swift_sim_bridge race.launch.py [seed:=0] [config:=DIR] [out:=results/launch] [lockstep:=true]
"""

import json
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from swift_ros.configuration import configuration_folder
from swift_ros.graph.discovery import choose
from swift_ros.graph.runner import launch_rows
from swift_sim_bridge.racing.race import RACERS, node_parameters

ARGUMENTS = (
    ("seed", "0", "seed of the race"),
    ("config", "", "configuration folder; empty: $SWIFT_CONFIG, else the installed one"),
    ("out", "results/launch", "new folder for the bag and the simulator's report"),
    ("lockstep", "true", "false: system clock, without waiting"),
    ("discovery", "local", "who can reach the graph: local (this machine) or subnet"),
)


def start_race(context):
    """Return the launch actions of flight nodes and simulator for the arguments."""
    values = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    out = Path(values["out"])
    out.mkdir(parents=True, exist_ok=True)
    domain = int(context.environment.get("ROS_DOMAIN_ID") or 0)
    parameters = node_parameters(int(values["seed"]), configuration_folder(values["config"]), out, domain)
    lockstep = values["lockstep"].lower() == "true"
    flight = Path(get_package_share_directory("swift_ros")) / "launch" / "flight.launch.py"
    arguments = {
        "nodes": ",".join(name for name in RACERS if name != "bridge"),
        "lockstep": values["lockstep"],
        "discovery": values["discovery"],
        "parameters": json.dumps(parameters),
    }
    choose(values["discovery"], context.environment)
    rows = launch_rows(["bridge"], parameters, lockstep=lockstep)
    flying = IncludeLaunchDescription(PythonLaunchDescriptionSource(str(flight)), launch_arguments=arguments.items())
    return [flying, Node(**rows["bridge"], output="both")]


def generate_launch_description():
    """Return the launch arguments and the race."""
    declared = [DeclareLaunchArgument(name, default_value=value, description=text) for name, value, text in ARGUMENTS]
    return LaunchDescription([*declared, OpaqueFunction(function=start_race)])
