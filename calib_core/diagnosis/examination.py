"""A recording with all that its diagnosis was read from, which comparisons with a simulation read too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stillcal.calib_core.diagnosis.clear_bins import CLEAR, limits_of
from stillcal.calib_core.diagnosis.model.hypothesis import SensorResiduals
from stillcal.calib_core.diagnosis.model.measurement import Measured
from stillcal.calib_core.diagnosis.model.records import Claims, Diagnosis, Finding
from stillcal.calib_core.diagnosis.model.rotation_alignment import Aligned
from stillcal.calib_core.diagnosis.motion.turning_windows import Span, on_limits
from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.diagnosis.slow.relinearised import AboutTurns
from stillcal.calib_core.diagnosis.slow.statement import Stated
from stillcal.calib_core.diagnosis.stream import Stream
from stillcal.calib_core.streams.samples import Samples


@dataclass(frozen=True, slots=True, eq=False)
class Examination:
    """A recording with all that its diagnosis was read from.

    bins: the static bins that slow effects are judged on; streams: each sensor's noise, steps and spectra;
    sensors: each sensor's slow residuals; turns: the rotation between rests (None where there is too little);
    aligned: both sensors' affine parameters (None without a gyroscope or rests); statements: the findings
    with the hypotheses they state. timed: whether it is known when what was recorded.
    exchanged: the sensor whose axes were exchanged; if for a while, nothing slow of it is searched for.
    other_axes: the finding where they are exchanged throughout.
    spoiled: when readings are no measurement, as while a sensor is stuck.
    delay: s, of the gyroscope behind the accelerometer; None where motion does not tell one.
    why_no_delay: the reason then, "" where motion is too little to look for it.
    about_turns: the turns without the effects that they show by name; None where they show none.
    memo: what was worked out of it once, by name.
    """

    accelerometer: Samples
    gyroscope: Samples | None
    claims: Claims
    bins: Bins
    streams: list[Stream]
    sensors: list[SensorResiduals]
    aligned: Aligned | None
    turns: SensorResiduals | None
    statements: list[Stated]
    timed: bool = True
    exchanged: str = ""
    other_axes: Finding | None = None
    spoiled: Sequence[Span] = ()
    delay: Measured | None = None
    why_no_delay: str = ""
    about_turns: AboutTurns | None = None
    memo: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    def diagnosis(self, recording: str) -> Diagnosis:
        """Return the findings. recording: the name it is known by."""
        return Diagnosis(recording, [s.finding for s in self.statements])

    @property
    def zone_at_rest(self) -> bool:
        """Whether a dead zone takes what the gyroscope reads at rest, its bias too."""
        return any(s.hidden for s in self.streams if s.sensor == "gyro")

    @property
    def turns_untold(self) -> bool:
        """Whether turns say nothing of scales: axes are exchanged, or the gyroscope's bias is not known."""
        return bool(self.exchanged) or self.zone_at_rest

    @property
    def with_turns(self) -> list[SensorResiduals]:
        """The residuals of both sensors, and those of the turns where there are any."""
        return [*self.sensors, *([self.turns] if self.turns else [])]

    @property
    def on_limits(self) -> list[Span]:
        """When one of the sensors is on a limit, found or claimed, or as near to it as noise reaches."""
        if self.gyroscope is None:
            return []
        found = [s.finding for s in self.statements]
        claimed = {"accel": self.claims.accel_range, "gyro": self.claims.gyro_range}
        limits = {}
        for stream in self.streams:
            stated = [*limits_of(f"{stream.sensor}_saturation", found), claimed[stream.sensor]]
            least = min((limit for limit in stated if limit), default=np.inf)
            limits[stream.sensor] = least - CLEAR * float(stream.steps.sd.max())
        return on_limits(self.accelerometer, self.gyroscope, limits)

    @property
    def column_means(self) -> dict[str, float]:
        """The means at rest of further logged columns."""
        return self.sensors[0].column_means if self.sensors else {}

    @property
    def is_table(self) -> bool:
        """Whether it is a table of rests, which has no samples."""
        return len(self.accelerometer) == 0
