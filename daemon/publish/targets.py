"""What may stand behind `--publish` and in `[publish] to`, and the publisher that each means."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from stillcal.daemon.publish.publishing import Publisher
from stillcal.daemon.settings import PublishSettings


def publishers(settings: PublishSettings) -> Iterable[Publisher]:
    """Yield the publishers of live samples that the settings name; each is imported when it is asked for."""
    for target in settings.to:
        if target.endswith(".mcap"):
            from stillcal.daemon.publish.mcap_files import McapFiles  # noqa: PLC0415 - only when it is asked for

            yield McapFiles(Path(target))
        elif target == "uinput":
            from stillcal.daemon.publish.uinput import MotionSensors  # noqa: PLC0415 - only when it is asked for

            yield MotionSensors()
