"""The base of every error that is the user's to fix, so that a defect of ours is never shown as one."""

from __future__ import annotations


class InputError(ValueError):
    """Something that the user gave cannot be used; one line that says what, where, and how to fix it.

    The command line prints it and exits with 2. Any other exception is a defect of the package and is reported as one.
    """
