"""Something without a name that a recording and a simulation of its motion differ by: whose it is."""

from __future__ import annotations

import pytest

from stillcal.calib_core.diagnosis.comparison.pair.stands import with_owner_of_unknown
from stillcal.calib_core.diagnosis.comparison.records import Comparison, Discrepancy
from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Parameter, Where
from stillcal.replay.diagnosis.answer import Fit, answer_of


def _unknown(driver: str, nats: float, amplitude: float = 1.0) -> Finding:
    where = Where(0.0, 600.0, (0.0, 0.05), driver)
    size = Parameter([amplitude] * 3, None, "rad/s")
    return Finding("unknown", "gyro", ["x"], where, {"amplitude": size}, Evidence(nats), [], "")


@pytest.mark.parametrize(
    ("recorded", "simulated", "relation", "either"),
    [
        ([("time", 20.0)], [], "lacking", False),
        ([], [("time", 20.0)], "superfluous", False),
        ([("time", 20.0)], [("time", 20.0)], "lacking", True),
        ([("temperature", 20.0)], [("motion", 20.0)], "lacking", True),
        ([], [], "lacking", True),
    ],
)
def test_what_has_no_name_is_of_the_one_that_shows_it_by_itself(
    recorded: list[tuple[str, float]], simulated: list[tuple[str, float]], relation: str, either: bool
) -> None:
    """The difference of the readings does not tell it; the sign is that of the owner's own readings."""
    found = _unknown("time", 50.0)
    apart = Discrepancy("unknown", "gyro", ["x"], found.where, "lacking", 1.0, 50.0, recorded=found)
    own = [_unknown(*one) for one in recorded]
    other = [_unknown(*one, amplitude=-1.0) for one in simulated]
    (one,) = with_owner_of_unknown(Comparison([apart]), own, other).discrepancies
    assert (one.relation, one.of_either) == (relation, either)
    assert (one.recorded, one.simulated) == ((None, other[0]) if relation == "superfluous" else (found, None))
    told = answer_of(Comparison([one]), ("real.csv", "sim.csv"), Fit(1.0, 1.0), {}, None)
    text = told["findings"][0]["statement"]
    assert ("is not known" in text) == either
    assert text.startswith("sim.csv shows") == (relation == "superfluous")
