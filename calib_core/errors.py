"""Errors that a user can mend, and the refusal of a fit that the data cannot support."""

from __future__ import annotations

from collections.abc import Sequence


class UserError(ValueError):
    """Something that the user can mend: its text is one line that says what is wrong and what to do."""


class TryAgainError(UserError):
    """The machine could not do it now, such as for want of room or memory; later it may."""


class NotSupported(UserError):  # noqa: N818 - it is a refusal, said as one, not a failure
    """What was asked for cannot be had from what was gathered.

    reason: what stands in the way. missing: what to gather to get it, a phrase for each, most wanted first.
    """

    def __init__(self, reason: str, missing: Sequence[str] = ()) -> None:
        remedy = f"; needed: {', '.join(missing)}" if missing else ""
        super().__init__(f"{reason}{remedy}")
        self.reason = reason
        self.missing = tuple(missing)
