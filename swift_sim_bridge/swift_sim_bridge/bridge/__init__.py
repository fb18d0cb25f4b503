"""The bridge node: the simulator in place of the vehicle's hardware.

graph_wait: wait until all nodes are present.
lockstep: pacing of ticks, in lockstep with the graph or by the steady clock.
report: the simulator's part of `result.json`.
node: the ROS node.
"""
