"""Package swift_sim_bridge: its executable, commands and data files."""

import runpy
from glob import glob
from pathlib import Path

from setuptools import setup

NAME = "swift_sim_bridge"
# resolved: colcon builds through a symbolic link to this file
SWIFT_ROS = Path(__file__).resolve().parent.parent / "swift_ros/swift_ros"
NODES = runpy.run_path(str(SWIFT_ROS / "graph/topic_table.py"))["NODES"].values()
COMMANDS = runpy.run_path(str(SWIFT_ROS / "commands/command_table.py"))["COMMANDS"]

setup(
    package_data={"swift_sim_bridge.labelling": ["page/*"], "swift_sim_bridge.gap.report": ["page.css"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/swift_sim_bridge"]),
        ("share/swift_sim_bridge", ["package.xml"]),
        ("share/swift_sim_bridge/launch", sorted(glob("launch/*.py"))),
    ],
    entry_points={
        "console_scripts": [node.entry_point for node in NODES if node.package == NAME],
        "swift.commands": [command.entry_point for command in COMMANDS if command.package == NAME],
    },
)
