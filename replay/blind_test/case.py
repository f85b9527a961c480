"""What one case of a blind test consists of."""

from __future__ import annotations

from dataclasses import dataclass

from stillcal.replay.blind_test.keys import Key
from stillcal.replay.blind_test.world.phones import MadeRecording


@dataclass(frozen=True, slots=True)
class Case:
    """A recording with its key.

    simulation: what is to be judged against it, where that is a recording too. phone: where it is a phone
    file, TOML; fresh: the fresh day that the phone written back is compared with.
    """

    recording: MadeRecording
    key: Key
    simulation: MadeRecording | None = None
    phone: str | None = None
    fresh: MadeRecording | None = None
