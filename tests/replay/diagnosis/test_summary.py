"""The lines for a terminal say what the fields of an answer say."""

from __future__ import annotations

from typing import Any

import pytest

from stillcal.calib_core.calibration.corrections.catalogue import ADOPT, ADOPTABLE
from stillcal.calib_core.diagnosis.comparison.records import Comparison, NotCompared
from stillcal.replay.diagnosis.answer import Fit, answer_of
from stillcal.replay.diagnosis.words.names import BUILT_IN
from stillcal.replay.diagnosis.words.summary import headline, outcome, remedy, summary


def answer(effect: str, verdict: str, **fit: Any) -> dict[str, Any]:
    """Return as much of an answer as its verdict is told from."""
    return {
        "recording": "real.csv",
        "simulation": BUILT_IN,
        "verdict": verdict,
        "findings": [{"effect": effect}],
        "not_compared": [],
        "checks": {"made": 9, "of": 10},
        "fit": {"p_before": 1e-9, "not_put_in": [], "still_different": []} | fit,
    }


@pytest.mark.parametrize(
    ("effect", "fit", "says"),
    [
        ("noise_heavy_tailed", {"p_after": 1e-9}, "named, but the corrected simulation does not fit"),
        ("unknown", {"p_after": 1e-9}, "not all identified"),
        ("noise_heavy_tailed", {}, "not all identified"),
    ],
)
def test_what_is_named_and_not_explained_is_told_from_what_has_no_name(
    effect: str, fit: dict[str, float], says: str
) -> None:
    assert says in headline(answer(effect, "partly_identified", **fit))


def test_findings_of_a_recording_that_is_not_judged_as_a_whole_are_told_of() -> None:
    said = answer("accel_nonlinearity", "not_judged")
    assert "those made show differences" in headline(said)
    assert "differences" not in headline(said | {"findings": []})


@pytest.mark.parametrize(("probability", "likely"), [(0.9, True), (0.4, False), (None, False)])
def test_a_likely_difference_is_named_where_none_is_sure(probability: float | None, likely: bool) -> None:
    open_one = NotCompared("accel_nonlinearity", "accel", "the recording does not decide it", probability)
    compared = Comparison(undecided=[open_one], comparisons=9)
    said = answer_of(compared, ("real.csv", "sim.csv"), Fit.of(compared, compared), {}, None)
    assert said["verdict"] == "match"
    assert headline(said).startswith("No difference is sure, but likely: nonlinearity") == likely
    assert headline(said).startswith("No difference found") != likely


@pytest.mark.parametrize("effect", ADOPTABLE)
def test_what_a_calibration_can_take_up_names_the_command(effect: str) -> None:
    said = answer(effect, "identified", p_after=1.0)
    assert f"can be corrected for {effect}: {ADOPT} " in remedy(said)
    assert not remedy(said | {"simulation": "sim.csv"})
    other = {"effect": "accel_bias_drift", "indistinguishable": True}
    assert not remedy(said | {"findings": [{"effect": effect, "alternatives": [other]}]})


def test_no_difference_names_the_bias_and_scale_that_were_not_compared() -> None:
    said = answer("", "match") | {"findings": []}
    assert headline(said) == "No difference found (9 of 10 checks possible)"
    said["not_compared"] = [
        {"effect": "accel_scale", "sensor": "accel", "reason": "the attitudes are too few or too alike"},
        {"effect": "lever_arm", "sensor": "accel", "reason": "the phone does not turn"},
    ]
    text = "No difference found in what was compared; not compared: accelerometer scale and misalignment"
    assert headline(said) == f"{text} (9 of 10 checks possible)"


@pytest.mark.parametrize(
    ("fit", "says"),
    [
        ({"not_put_in": ["unknown", "unknown"]}, "What has no name cannot be put into"),
        ({"not_put_in": ["unknown", "sample_rate"]}, "left out of both: sample rate"),
    ],
)
def test_nothing_is_said_to_be_put_in_where_nothing_was(fit: dict[str, Any], says: str) -> None:
    text = outcome(answer("unknown", "unidentified", p_after=1e-9, **fit))
    assert says in text and "found put in" not in text and text.count("as before") == 1
    whole = answer("unknown", "partly_identified", p_after=1e-9, **fit)
    text = outcome(whole | {"findings": [{"effect": "unknown"}, {"effect": "gyro_warmup"}]})
    assert "With what has a name put in" in text and "counts in both" in text


def test_what_cannot_be_put_into_samples_is_named_and_the_rest_judged() -> None:
    said = answer("sample_rate", "identified", p_after=1.0, not_put_in=["sample_rate"])
    said["fit"]["p_before"] = 1.0
    assert outcome(said | {"simulation": "sim.csv"}) == (
        "This cannot be put into the samples of sim.csv: sample rate. In all else it passes the comparison"
        " (bound of p: 1)."
    )


def test_a_correction_that_fails_names_what_differs_in_spite_of_it() -> None:
    left = [{"effect": "noise_heavy_tailed", "sensor": "accel"}]
    text = outcome(answer("noise_heavy_tailed", "partly_identified", p_after=1e-9, still_different=left))
    assert "still fails" in text and "What differs then: heavy tails of the noise (accelerometer)." in text


def test_a_line_that_agrees_has_its_frequency_for_another_may_differ() -> None:
    line = {"frequency": {"value": 17.3, "ci95": [17.299, 17.301], "unit": "Hz"}}
    agreed = [
        {"effect": "vibration_tone", "sensor": "accel", "parameters": line},
        {"effect": "noise_level", "sensor": "gyro", "parameters": {}},
    ]
    rest = {"findings": [], "agreed": agreed, "not_compared": [], "sensitivity": []}
    text = "\n".join(summary(answer("unknown", "match") | rest))
    assert (
        "vibration at one frequency (accelerometer), 17.30000 ± 0.00100 Hz, white noise (gyroscope)" in text
    )
