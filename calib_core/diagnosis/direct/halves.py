"""Whether both halves of a recording bear out what its noise at rest shows as a whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stillcal.calib_core.diagnosis.model.measurement import Measured, of_measured
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.model.sound_phones import SoundPhones, usual
from stillcal.calib_core.diagnosis.noise.coloured_noise import DRIVER as COLOURED

QUANTITIES = {
    "bandwidth": ("bandwidth", "bandwidth_of_some_axes"),
    "noise_heavy_tailed": ("excess_kurtosis",),
    "noise_unequal_axes": ("{sensor}_noise_plane", "{sensor}_noise_upright"),
}
"""Effects of a sensor's noise that last as long as the recording, with the quantities that show them."""


def quantities_of(finding: Finding) -> tuple[str, ...]:
    """Return the quantities that show a finding which lasts as long as the recording; none of any other."""
    if finding.effect == "unknown":
        return ("noise_coloured",) if finding.where.driver == COLOURED else ()
    return QUANTITIES.get(finding.effect, ())


def borne_out(
    finding: Finding, halves: Sequence[Mapping[str, Measured]], sound: SoundPhones, claim: float | None
) -> bool:
    """Whether each half that measures the effect's quantities speaks for it, and one at least does measure.

    It does where one of them is more probable of a faulty phone than of a sound one; the bar for stating
    it is for the whole. Of a few rests one that trembles decides. claim: the declared noise density.
    """
    shown = quantities_of(finding)
    if not shown:
        return True
    names = [name.format(sensor=finding.sensor) for name in shown]
    of_halves = [
        [of_measured(half[n], usual(sound, n, claim)).log_bayes_factor for n in names if n in half]
        for half in halves
    ]
    judged = [max(nats) for nats in of_halves if nats]
    return bool(judged) and min(judged) > 0.0
