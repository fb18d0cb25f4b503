"""Other people's flight recordings as bags of this graph: one module a format.

A module of a format has `find(path)`, which returns the recordings of its format at a file or folder, and
`read(source)`, which returns one of them as a ForeignFlight.
"""
