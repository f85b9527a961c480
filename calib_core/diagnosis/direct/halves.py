"""Whether both halves of a recording bear out what its noise at rest shows as a whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from stillcal.calib_core.diagnosis.model.measurement import Measured, of_measured
from stillcal.calib_core.diagnosis.model.records import Finding
from stillcal.calib_core.diagnosis.model.sound_phones import SoundPhones, usual

QUANTITIES = {
    "bandwidth": ("bandwidth",),
    "noise_heavy_tailed": ("excess_kurtosis",),
    "noise_unequal_axes": ("{sensor}_noise_plane", "{sensor}_noise_upright"),
}
"""Effects of a sensor's noise that last as long as the recording, with the quantities that show them."""


def borne_out(
    finding: Finding, halves: Sequence[Mapping[str, Measured]], sound: SoundPhones, claim: float | None
) -> bool:
    """Whether each half that measures the effect's quantities speaks for it, and one at least does measure.

    It does where one of them is more probable of a faulty phone than of a sound one; the bar for stating
    it is for the whole. Of a few rests one that trembles decides. claim: the declared noise density.
    """
    measured = False
    for half in halves:
        names = [name.format(sensor=finding.sensor) for name in QUANTITIES.get(finding.effect, ())]
        nats = [
            of_measured(half[name], usual(sound, name, claim)).log_bayes_factor
            for name in names
            if name in half
        ]
        if nats and max(nats) <= 0.0:
            return False
        measured = measured or bool(nats)
    return measured or finding.effect not in QUANTITIES
