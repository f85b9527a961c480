"""The simulated phone: motion, heat, sensors, clock.

A forward model that shares no formula with calib_core, of which it uses the sample blocks and events only.
"""

from stillcal.replay.phone.phone import Phone, dump_phone, load_phone
from stillcal.replay.phone.plan import Event
from stillcal.replay.phone.population import population
from stillcal.replay.phone.rest_means import RestDraws, draw_rests
from stillcal.replay.phone.scenario import Scenario, load_scenario
from stillcal.replay.phone.simulation import Chunk, Simulation, Truth, simulate

__all__ = [
    "Chunk",
    "Event",
    "Phone",
    "RestDraws",
    "Scenario",
    "Simulation",
    "Truth",
    "draw_rests",
    "dump_phone",
    "load_phone",
    "load_scenario",
    "population",
    "simulate",
]
