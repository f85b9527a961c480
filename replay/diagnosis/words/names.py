"""What effects, sensors and simulations are called in a sentence."""

from __future__ import annotations

from stillcal.calib_core.diagnosis.effects.catalogue import named_effects
from stillcal.calib_core.diagnosis.effects.covariate import SUFFIX
from stillcal.calib_core.diagnosis.effects.described import DESCRIBED
from stillcal.calib_core.diagnosis.effects.followed import driver_of
from stillcal.calib_core.diagnosis.model.records import NAME as SENSORS

THE_BUILT_IN = "the built-in simulation"

OF_EITHER = frozenset(
    {
        "noise_level",
        "noise_unequal_axes",
        "noise_heavy_tailed",
        "vibration_tone",
        "bandwidth",
        "held_samples",
        "missing_codes",
        "axis_exchange",
        "thermal_latent",
        "unknown",
    }
)
"""Effects of either sensor whose name does not say of which."""

BUILT_IN = "built-in"
"""The built-in simulation's name: an ideal affine sensor with plain noise, moved as the recording moved."""


def _of_column(effect: str, sensor: str) -> str:
    """Return the noun of a bias that follows a logged column, or an unknown effect's own words."""
    start, _, column = effect.partition("_bias_")
    if start == sensor and column:
        return f"change of the {SENSORS[sensor]}'s bias with {driver_of(column.removesuffix(SUFFIX))}"
    return effect.replace("_", " ")


def noun(effect: str, sensor: str) -> str:
    """Return what an effect is called in a sentence."""
    named = {e.name: e.called() for e in named_effects()}
    known = DESCRIBED.get(effect)
    name = known.noun if known else named.get(effect) or _of_column(effect, sensor)
    return f"{name} ({SENSORS[sensor]})" if effect in OF_EITHER and sensor in SENSORS else name


ON_AXES = " on {axes}."
"""How a sentence of the catalogue ends that has a place for the axes."""


def behaviour(effect: str, sensor: str) -> str:
    """Return what a sensor does that has an effect, as a sentence without its stop."""
    named = {(e.name, e.sensor): e.sentence for e in named_effects()}
    sentence = named.get((effect, sensor), "")
    if sentence.endswith(ON_AXES):
        return sentence.removesuffix(ON_AXES).removesuffix(",")
    known = DESCRIBED.get(effect)
    return f"The {SENSORS[sensor]} shows {known.noun if known else noun(effect, sensor)}"


PARAMETERS = {
    "tau_s": "time constant",
    "period_s": "period",
    "relative": "error of the rate",
    "scale_against_mean": "scale against the mean of the axes",
    "allan_deviation_100s": "Allan deviation at 100 s",
}
"""What parameters are called whose name in JSON is not a word."""


def parameter_noun(name: str) -> str:
    """Return what a parameter is called in a sentence, a table or a figure."""
    return PARAMETERS.get(name) or name.replace("_", " ")


def simulation_text(name: str) -> str:
    """Return what a simulation is called in a sentence."""
    return THE_BUILT_IN if name == BUILT_IN else name


def capital(text: str) -> str:
    """Return a text with a capital at its beginning."""
    return text[:1].upper() + text[1:]
