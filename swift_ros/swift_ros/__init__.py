"""What flies: the nodes of the graph, the cores that they call, and the commands that run on the vehicle too.

Modules that the packages below share:
    cli             the command `swiftros`
    configuration   reads `config/*.yaml` into dataclasses
    vehicle, track  the vehicle file and the track
    types           data types that the cores exchange
    geometry        rotations and rigid transforms
    corner_rays     residuals of the rays to a gate's corners
    timeline        buffer of past odometry
    messages        conversions between messages and data types
    mavlink         messages for a ground station
    results, text   result folders and tables of commands
    errors          errors that a user can correct

Packages:
    files           files that a user gives: the text of YAML, the images in a folder
    graph           nodes and topics as tables, and the runner of the processes
    nodes           the nodes, thin shells around the cores
    camera, perception, estimation, policy, betaflight, race
                    the cores, which import no ROS
    recording       bags, flight tables, replay
    importers       foreign recordings as bags
    commands        the commands
"""

import os

# The Linux packages of ONNX Runtime send usage data to their maker. Nothing that flies talks to the network unasked;
# set before the first import of onnxruntime, here and in every process started from here.
os.environ["ORT_DISABLE_TELEMETRY"] = "1"
