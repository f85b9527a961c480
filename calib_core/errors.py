"""Errors that a user can correct, and the refusal of a result that the data do not support."""

from __future__ import annotations

from collections.abc import Sequence


class UserError(ValueError):
    """An error that the user can correct; its text is one line that says what is wrong and what to do."""


class TryAgainError(UserError):
    """The machine could not do it now, such as for want of room or memory; later it may."""


class NotSupported(UserError):  # noqa: N818 - a refusal is not a failure, so its name does not end in Error
    """Refusal of a result because the data gathered do not support it.

    reason: why not. missing: what to gather for it, one phrase each, most important first.
    """

    def __init__(self, reason: str, missing: Sequence[str] = ()) -> None:
        remedy = f"; needed: {', '.join(missing)}" if missing else ""
        super().__init__(f"{reason}{remedy}")
        self.reason = reason
        self.missing = tuple(missing)
