"""Plots that several parts share, drawn into Matplotlib axes.

curves  quantities of a training log
track   the gates of a track, projected onto two axes of the map
"""
