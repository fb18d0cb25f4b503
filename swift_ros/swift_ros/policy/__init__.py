"""The pilot: from a state to a command.

gates          passages by the pilot's own estimate
observation    observation of the network
actor          the network
action         output of the network to a command
pilot          the pilot in a race
"""
