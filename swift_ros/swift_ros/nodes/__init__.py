"""The nodes: each converts messages, calls one core object and publishes what it returns.

In the order of the data flow:

    camera                images from a device or from files
    vio                   checks and converts visual-inertial odometry
    gate_detector         corners of gates in images
    gate_pose             poses of the detected gates
    state_estimator       pose of the vehicle in the map
    policy                body-rate and thrust commands
    betaflight            commands to the flight controller, over MSP
    race_monitor          judge of the race and health of the graph
    recorder              rosbag2 recording of all topics
    mavlink_telemetry     telemetry to a ground station
    replay_publisher      plays a recording to the nodes, inside `swiftros replay`
    domain_listener       receives topics for the commands that inspect the graph

Shared by the nodes: `shell` (base class and main function), `parameters` (settings as ROS parameters) and
`polled_subscriptions` (subscriptions without callbacks).
"""
