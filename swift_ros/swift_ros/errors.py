"""Errors that a user can mend."""


class UsageError(Exception):
    """Bad input: its text is one sentence that says what is wrong, where, and what to do. Commands exit with 2."""
