"""The referee of the gap tool: it conceals effects in flights of another simulator, seals what it concealed, lets the
tool diagnose the recordings, and only then opens the answers and scores them.

What makes cases is written a second time on purpose: it imports neither the tool nor the simulator, so that an error
shared by both cannot hide. Only `runner` calls the tool.
"""
