"""The node graph.

topic_table     all nodes and topics, with types, rates and priorities
qos             quality of service of a topic
domain          the ROS domain of a run
runner          starts nodes as processes and reports dead ones
topic_health    rates, latencies and silent topics of the running graph
latency         latency of each hop from publication times
"""
