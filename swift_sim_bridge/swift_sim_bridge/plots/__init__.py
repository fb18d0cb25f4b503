"""Plots that several parts share, drawn into Matplotlib axes.

track   the gates of a track, projected onto two axes of the map
"""
