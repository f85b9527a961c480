"""The simulated phone: motion, heat, sensors, clock; a forward model that shares no formula with calib_core."""

from stillcal.replay.phone.phone import Phone, dump_phone, load_phone
from stillcal.replay.phone.plan import Charging, Event, Location
from stillcal.replay.phone.scenario import Scenario, load_scenario
from stillcal.replay.phone.simulation import Chunk, Simulation, Truth, simulate

__all__ = [
    "Charging",
    "Chunk",
    "Event",
    "Location",
    "Phone",
    "Scenario",
    "Simulation",
    "Truth",
    "dump_phone",
    "load_phone",
    "load_scenario",
    "simulate",
]
