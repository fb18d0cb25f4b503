"""Table of the records of a configuration folder: whole files, and sections of the others. Plain data.

A record is named by its module, for it may be in a package that is not installed on the vehicle.
"""

RECORDS = {
    "drone.yaml": "swift_ros.vehicle:Vehicle",
    "track.yaml": "swift_ros.track:Track",
    "camera.yaml": "swift_ros.camera.model:Camera",
}
SECTIONS = {
    "nodes.yaml": {
        "camera": "swift_ros.camera.sources:CameraSettings",
        "gate_detector": "swift_ros.perception.settings:DetectorSettings",
        "vio": "swift_ros.estimation.odometry_check.vio_guard:VioSettings",
        "gate_pose": "swift_ros.perception.gate_pose:GatePoseSettings",
        "state_estimator": "swift_ros.estimation.settings:EstimatorSettings",
        "policy": "swift_ros.nodes.policy:Settings",
        "race_monitor": "swift_ros.race.control:RaceSettings",
        "betaflight": "swift_ros.betaflight.link_settings:LinkSettings",
        "recorder": "swift_ros.nodes.recorder:Settings",
        "bridge": "swift_sim_bridge.bridge.node:BridgeSettings",
        "mavlink_telemetry": "swift_ros.nodes.mavlink_telemetry:Settings",
    },
    "simulation.yaml": {
        "renderer": "swift_sim_bridge.rendering.scene:Looks",
        "flight_controller": "swift_sim_bridge.flight_controller.firmware_settings:FirmwareSettings",
        "imu": "swift_sim_bridge.sensors.imu:ImuSettings",
        "attitude_estimate": "swift_sim_bridge.sensors.attitude:AttitudeSettings",
        "vio": "swift_sim_bridge.sensors.vio:VioSettings",
    },
    "training.yaml": {
        "policy": "swift_sim_bridge.pilot.settings:PolicySettings",
        "detector": "swift_sim_bridge.gate_detector.training.settings:DetectorTraining",
    },
}
# Checks of more than one record, and of what only the simulator knows of a vehicle. Each takes the records that were
# read, by file and by (file, section), with "folder", and yields findings about those it needs.
JOINT_CHECKS = ("swift_ros.commands.joint_checks:findings", "swift_sim_bridge.simulation.checks:findings")
