"""Commands of `swiftros` that run on the vehicle too.

command_table       all commands, also those of the workstation
record              records the running graph into a bag
import_recording    converts foreign recordings to bags
replay              replays a bag through the perception nodes
topics              inspects the running graph
check               recomputes a result from its bags
output              standard output whose reader may leave early
"""
