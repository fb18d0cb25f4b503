"""Imports foreign flight recordings as bags of this graph.

blackbird         Blackbird data set
nanobench         NanoBench data set
blackbox          Betaflight blackbox logs
blackbox_log      decoder of the frames of a blackbox log
blackbox_bytes    decoder of the numbers in a frame
alignment         alignment of a log's clock to another recording's
flight            the imported flight and its bag

Each of the first three modules has a function `find(path)`, which returns the recordings of its format at a file or
folder, and a function `read(source)`, which returns one of them as a ForeignFlight.
"""
