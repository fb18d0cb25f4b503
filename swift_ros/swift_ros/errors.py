"""Errors that a user can correct, and warnings that a user should read."""


class UsageError(Exception):
    """Bad input. Its text is one sentence: what is wrong, where, and what to do. Commands exit with code 2."""


class DamagedRecording(UserWarning):
    """A part of a recording cannot be read; the rest is. Its text names the part and what is missing."""
