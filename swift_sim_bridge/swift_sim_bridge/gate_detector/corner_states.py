"""The states of a labelled corner."""

HIDDEN, VISIBLE, IGNORED = 0, 1, 2
BORDER_PX = 2.5  # a corner this near to an occluder or to the edge of the image circle is ignored
