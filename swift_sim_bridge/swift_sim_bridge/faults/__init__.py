"""Faults drawn at random, planted into races, and how each of these races ended.

catalogue: kinds of faults, and the draw of one. message_errors: errors in a single message. relay: a node between the
publisher of a topic and its subscribers, and a foreign publisher. serial_line: the bytes between link and flight
controller. injection: a race with a fault. ending: how it ended. batch: many of them. tables, picture: the summary.
"""
