"""Labelled images of gates: files, proposals, the page on which a person corrects them, labels from flights."""
