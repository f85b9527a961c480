"""The rests that temperature is learnt from: bounded, and spread over temperature, attitude and age."""

from __future__ import annotations

import msgspec
import numpy as np

from stillcal.calib_core.arrays import frozen
from stillcal.calib_core.codec import packed, unpacked
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.temperature.memory import MAX_AGE_S, MOST_RESTS, Memory

UP, SD = np.array([0.0, 0.0, 9.8]), frozen(np.full(3, 1e-4))


def rest(t: float, celsius: float | None = 20.0, force: np.ndarray = UP, rate: bool = True) -> RestState:
    rates = {"rate": frozen(np.ones(3)), "rate_sd": SD, "rate_uncertainty": SD} if rate else {}
    return RestState(t, t + 20.0, 1000, frozen(force), SD, SD, 0.01, temperature=celsius, **rates)


def filled(rests: list[RestState]) -> Memory:
    memory = Memory()
    for one in rests:
        memory = memory.with_rest(one, 9.81)
    return memory


def test_a_rare_temperature_and_a_rare_attitude_outlast_a_crowd() -> None:
    rare = [rest(0.0, celsius=35.0), rest(100.0, force=-UP)]
    crowd = [rest(1000.0 + 60.0 * k) for k in range(2 * MOST_RESTS)]
    memory = filled(rare + crowd)
    assert len(memory) == MOST_RESTS
    assert memory.celsius.max() == 35.0 and memory.force[:, 2].min() < 0.0
    assert memory.t[-1] == crowd[-1].t_start + 10.0
    assert (np.diff(memory.t) > 0).all()


def test_how_long_no_rest_had_come_is_remembered_where_the_rest_before_has_gone() -> None:
    memory = filled([*(rest(60.0 * k) for k in range(MOST_RESTS)), rest(60.0 * MOST_RESTS + 3000.0)])
    assert len(memory) == MOST_RESTS and np.isnan(memory.since[0])
    assert memory.since[1:].tolist() == [60.0] * (MOST_RESTS - 2) + [3060.0]


def test_a_memory_saved_before_that_was_remembered_is_read() -> None:
    saved = msgspec.msgpack.decode(packed(filled([rest(0.0), rest(100.0)])))
    del saved["since"]
    again = unpacked(msgspec.msgpack.encode(saved), Memory)
    assert again.t.tolist() == [10.0, 110.0] and np.isnan(again.since).all() and again.since.shape == (2,)


def test_old_rests_go() -> None:
    memory = filled([rest(0.0), rest(MAX_AGE_S - 100.0), rest(MAX_AGE_S + 100.0)])
    assert memory.t.tolist() == [MAX_AGE_S - 90.0, MAX_AGE_S + 110.0]


def test_what_a_rest_lacks_is_unknown_and_all_is_saved_and_read_back() -> None:
    memory = filled([rest(0.0, celsius=None, rate=False), rest(100.0)])
    assert (
        np.isnan(memory.celsius[0])
        and np.isnan(memory.rate[0]).all()
        and memory.rate[1].tolist() == [1.0] * 3
    )
    for one in (Memory(), memory):
        again = unpacked(packed(one), Memory)
        assert again.rate.shape == one.rate.shape
        assert np.array_equal(again.force, one.force) and np.array_equal(
            again.celsius, one.celsius, equal_nan=True
        )
    assert memory.at_gravity(9.79).gravity.tolist() == [9.79, 9.79]
