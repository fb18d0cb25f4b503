"""Package swift_sim_bridge: its executable, commands and data files."""

from glob import glob

from setuptools import setup

setup(
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/swift_sim_bridge"]),
        ("share/swift_sim_bridge", ["package.xml"]),
        ("share/swift_sim_bridge/launch", sorted(glob("launch/*.py"))),
    ],
    entry_points={
        "console_scripts": ["bridge = swift_sim_bridge.bridge.node:main"],
        # each names a function that adds its parser: see swift_ros/cli.py
        "swift.commands": [
            "bench = swift_sim_bridge.commands.bench:command",
            "evaluate = swift_sim_bridge.commands.evaluate:command",
            "gap = swift_sim_bridge.commands.gap:command",
            "gap-referee = swift_sim_bridge.commands.gap_referee:command",
            "identify = swift_sim_bridge.commands.identify:command",
            "race = swift_sim_bridge.commands.race:command",
            "sim = swift_sim_bridge.commands.sim:command",
            "train = swift_sim_bridge.commands.train:command",
        ],
    },
)
