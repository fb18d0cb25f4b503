"""An hour of races or of the simulator, watched: memory of each process, and commands that come late.

processes: memory of a command and its nodes. late_commands: age of the commands, and how long the machine stalled.
hover: a pilot that flies the simulator by topics. run: one soak. picture: its memory and late commands by minute.
"""
