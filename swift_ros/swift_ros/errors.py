"""Errors that a user can correct."""


class UsageError(Exception):
    """Bad input. Its text is one sentence: what is wrong, where, and what to do. Commands exit with code 2."""
